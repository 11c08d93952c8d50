"""What the explorer of a campaign on bearings is asked."""

from explorer.conftest import form as form_of

from activefail.seismic.bearing.design import TABLE_1


def form(X: list[float], **values: object) -> dict[str, object]:
    """The form of the page of one design of a bearing, as a browser sends it."""
    return form_of(X, TABLE_1.names, **values)
