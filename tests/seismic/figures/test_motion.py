"""The pictures of one bearing show what the kernels compute."""

import math
import re
import subprocess
import sys
from collections.abc import Callable

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from patience import PATIENCE

from activefail.errors import InputError
from activefail.pages.figures import style
from activefail.seismic.bearing import Accelerogram, Bearing, Model, Pulse, Response, Tolerance, simulate_one
from activefail.seismic.bearing.contact import gap
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.dynamics import lever
from activefail.seismic.bearing.motion import LONGEST_STEP, Motion, instants
from activefail.seismic.bearing.outcome import observe
from activefail.seismic.figures import bodies as b
from activefail.seismic.figures import motion as m
from activefail.seismic.views.film import stills

FAILING = Bearing.from_table(4.0, 0.06, 0.6, 0.6, 0.1, 45.0, 2e9)
TOUCHING = Bearing.from_table(2.64, 0.106, 0.599, 0.7375, 0.1813, 56.4, 3.12e9)


@pytest.fixture(scope="module")
def failure() -> Response:
    return simulate_one(FAILING, Pulse(2.5, 0.5 * GRAVITY))


@pytest.fixture(scope="module")
def impact() -> Response:
    return simulate_one(TOUCHING, Pulse(3.247, 0.33 * GRAVITY))


@pytest.fixture(scope="module")
def no_impact() -> Response:
    return simulate_one(FAILING, Pulse(2.5, 0.15 * GRAVITY))


@pytest.fixture(scope="module")
def given_up() -> Response:
    return simulate_one(FAILING, Pulse(2.5, 0.5 * GRAVITY), tolerance=Tolerance(most_steps=200))


@pytest.fixture(params=["failure", "impact", "no_impact", "given_up"])
def response(request: pytest.FixtureRequest) -> Response:
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def plotted() -> Callable[[Response], Figure]:
    """The pictures of these responses, each made once, for tests that only read them."""
    made: dict[int, Figure] = {}

    def of(response: Response) -> Figure:
        if id(response) not in made:
            made[id(response)] = m.plot_response(response)
        return made[id(response)]

    return of


def drawn(response: Response, time: float) -> list[b.Shape]:
    return list(b.shapes(Motion(response), time))


def slider(response: Response, time: float) -> np.ndarray:
    """The outline of the drawn slider."""
    (one,) = (shape for shape in drawn(response, time) if shape.fill == style.SKY_BLUE)
    return one.outline


def rims(shapes: list[b.Shape]) -> list[b.Shape]:
    """The drawn rims: of the bottom plate, left and right, and of the top plate."""
    return [shape for shape in shapes if len(shape.outline) == 4 and shape.fill in ("", style.GREY)]


def words(figure: Figure) -> str:
    return " ".join(text.get_text() for text in figure.texts)


def test_the_examples_have_the_outcomes_that_they_are_named_after(failure, impact, no_impact, given_up):
    assert (failure.outcome_name, failure.cause_name) == ("failure", "loss_of_confinement")
    assert impact.outcome_name == "impact"
    assert no_impact.outcome_name == "no_impact"
    assert given_up.outcome_name == "numerical_failure"


def test_every_panel_of_a_response_is_finite_and_names_its_axes_with_units(response, plotted):
    figure = plotted(response)
    figure.canvas.draw()
    labels = [panel.get_ylabel() for panel in figure.axes]
    for expected in ("Displacement [m]", "Ground acceleration [g]", "[mm]", "[°]", "Rim force / $Mg$ [-]", "/Mg$ [-]"):
        assert any(expected in label for label in labels), expected
    assert [panel.get_xlabel() for panel in figure.axes] == [
        *["Time from the pulse's centre [s]"] * 5,
        "Displacement of the top plate $x_t$ [m]",
    ]
    for panel in figure.axes:
        for line in panel.get_lines():
            assert np.isfinite(np.asarray(line.get_xydata(), dtype=float)).all()


def test_the_ground_motion_of_a_record_has_its_vertical_component_too():
    t = np.arange(0.0, 6.0, 0.02)
    level = Accelerogram(1.5 * np.sin(t), 0.02, "level")
    risen = level.with_vertical(Accelerogram(0.8 * np.cos(t), 0.02, "up"))
    for record, labels in ((level, set()), (risen, {"vertical", "horizontal"})):
        ground = m.plot_response(simulate_one(FAILING, record)).axes[1]
        assert set(ground.get_legend_handles_labels()[1]) - {"first rim touch", "failure"} == labels
    times, up = ground.get_lines()[0].get_xdata(), ground.get_lines()[0].get_ydata()
    during = times <= t[-1]
    np.testing.assert_allclose(up[during], 0.8 * np.cos(times[during]) / GRAVITY, atol=1e-4)


def test_histories_share_one_axis_of_time_and_mark_what_befell(failure, no_impact):
    for response, events in ((failure, {"first rim touch", "failure"}), (no_impact, set())):
        panels = m.plot_histories(response, width=3.6).axes
        assert [panel.get_ylabel() for panel in panels] == ["Displacement [m]", "Ground [g]", "Gap [mm]", "Tilt [°]"]
        assert len({panel.get_xlim() for panel in panels}) == 1
        assert set(panels[1].get_legend_handles_labels()[1]) == events
        (curve, *_) = panels[3].get_lines()
        assert curve.get_xdata()[-1] == pytest.approx(Motion(response).end)


def test_the_title_states_the_outcome_its_cause_and_the_design_with_units(response, plotted):
    title = words(plotted(response))
    when = f"{response.margins.failure_time:.3f}".replace("-", "−")
    assert {
        "failure": f"Failure by loss of confinement at t = {when} s",
        "impact": "Rim impact without failure",
        "no_impact": "No impact",
        "numerical_failure": "Numerical failure (too many steps): no statement about the bearing",
    }[response.outcome_name] in title
    assert "$D_{sl}$ 0.300 m" in title
    assert "MPa" in title
    assert "N/m$^{1.5}$" in title


def test_only_moments_that_came_are_marked(failure, impact, no_impact, plotted):
    def marked(response):
        return set(plotted(response).axes[1].get_legend_handles_labels()[1])

    assert marked(failure) == {"first rim touch", "failure"}
    assert marked(impact) == {"first rim touch"}
    assert marked(no_impact) == set()


def test_gaps_and_rim_forces_are_those_of_the_event_functions(failure):
    motion = Motion(failure)
    gaps, rims = motion.contacts(motion.steps)
    seen = [observe(motion.system, q, v) for q, v in zip(failure.q, failure.v, strict=True)]
    np.testing.assert_allclose(gaps.max(axis=1), [o.confinement_gap for o in seen], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(rims.max(axis=1), [o.rim_force for o in seen], rtol=1e-6, atol=1.0)


def test_a_motion_passes_through_the_accepted_steps_and_divides_long_ones(no_impact):
    motion = Motion(no_impact)
    t = motion.fine_times()
    assert np.diff(no_impact.t).max() > LONGEST_STEP
    assert np.diff(t).max() <= LONGEST_STEP * (1.0 + 1e-9)
    assert (np.diff(t) > 0.0).all()
    assert np.abs(t[np.searchsorted(t, motion.steps - 1e-12)] - motion.steps).max() < 1e-12
    np.testing.assert_allclose(motion.position(no_impact.t), no_impact.q, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(motion.velocity(no_impact.t), no_impact.v, rtol=0.0, atol=1e-12)


def test_an_interpolated_velocity_is_the_rate_of_the_interpolated_position(impact):
    motion = Motion(impact)
    t = motion.fine_times()
    middle, half = 0.5 * (t[1:] + t[:-1]), 1e-5
    rate = (motion.position(middle + half) - motion.position(middle - half))[:, 3] / (2.0 * half)
    assert np.abs(rate - motion.velocity(middle)[:, 3]).max() < 0.02 * np.abs(impact.v[:, 3]).max()


def test_the_plotted_loop_has_the_stiffness_and_the_friction_of_the_bearing(no_impact, plotted):
    (curve, *_) = plotted(no_impact).axes[5].get_lines()
    x, force = np.asarray(curve.get_xydata()).T
    motion = Motion(no_impact)
    v = motion.velocity(motion.fine_times())[:, 3]
    sliding = np.abs(v) > 0.1
    terms = np.column_stack((x[sliding], np.sign(v[sliding])))
    (stiffness, friction), *_ = np.linalg.lstsq(terms, force[sliding])
    # The quasi-static loop F/W = tan(α ± ψ) for small angles: the slider's height shortens the pendulum to L.
    length = 2.0 * math.sqrt(FAILING.radius**2 - FAILING.slider_diameter**2 / 4.0) - FAILING.slider_height
    assert stiffness == pytest.approx(1.0 / length, rel=0.02)
    assert friction == pytest.approx(2.0 * FAILING.radius * FAILING.mu / length, rel=0.02)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 0.97, 1.0])
def test_the_drawn_slider_has_its_vertices_where_the_kernels_have_them(failure, share):
    time = failure.t[0] + share * (failure.t[-1] - failure.t[0])
    motion = Motion(failure)
    q = motion.position(time)
    corners = slider(failure, time)[[0, b.ARC_POINTS - 1, 2 * b.ARC_POINTS - 1, b.ARC_POINTS]]
    expected = [q[:2] + lever(motion.system, vertex, q[2]) for vertex in range(4)]
    np.testing.assert_allclose(corners, expected, rtol=0.0, atol=1e-12)


def test_the_last_drawn_state_is_the_failing_one(failure):
    last = failure.t[-1] + 1.0
    np.testing.assert_allclose(slider(failure, last).mean(axis=0), failure.q[-1, :2], atol=1e-3)
    assert b.vertex_states(Motion(failure), failure.t[-1]) == [b.LIFTED] * 4
    assert sum(shape.fill == "#ffffff" for shape in drawn(failure, last)) == 4


def test_a_drawn_plate_is_the_kernels_dish_with_their_rim():
    motion = Motion(simulate_one(FAILING, Pulse(0.5, 0.1)))
    plate = motion.system.bottom
    outline = b.plate_outline(FAILING)
    dish = outline[3:-3]
    assert max(abs(gap(u, w, plate)) for u, w in dish) < 1e-12
    assert dish[-1, 0] == pytest.approx(plate.rim_distance)
    for rim in b.rim_outlines(FAILING):
        assert np.abs(rim[:, 0]).min() == pytest.approx(plate.rim_distance)
        assert rim[:, 1].max() == pytest.approx(plate.rim_top)
    assert outline[:, 1].max() == pytest.approx(plate.rim_top)


def test_a_rim_that_yields_is_drawn_further_out_a_broken_one_as_an_outline_and_an_absent_one_not_at_all():
    def at_the_end(**settings) -> tuple[Response, list[b.Shape]]:
        response = simulate_one(FAILING, Pulse(2.5, 0.27 * GRAVITY), Model(**settings))
        return response, rims(drawn(response, response.t[-1]))

    strong, drawing = at_the_end(rim="yielding", rim_strength=0.6, rim_deformation=0.15)
    assert strong.outcome_name == "impact"
    edge = FAILING.dish_diameter / 2.0
    bottom_left, bottom_right, top_left, _ = (shape.outline for shape in drawing)
    assert bottom_left[:, 0].max() == pytest.approx(-edge - strong.rims[-1, 0])
    assert bottom_right[:, 0].min() == pytest.approx(edge + strong.rims[-1, 1])
    assert top_left[:, 0].max() == pytest.approx(strong.q[-1, 3] - edge - strong.rims[-1, 2])
    assert strong.rims[-1].min() > 5e-3
    weak, drawing = at_the_end(rim="breaking", rim_strength=0.6)
    assert weak.cause_name == "rim_fracture"
    assert [bool(rim.fill) for rim in drawing[:2]] == [False, True]
    none, drawing = at_the_end(rim="none")
    assert none.cause_name == "escape"
    assert drawing == []
    assert b.OVER_RIM in b.vertex_states(Motion(none), none.t[-1])
    for response in (strong, weak, none):
        assert m.plot_response(response).axes
        assert stills(response, "a bearing").count(", t = ") == len(instants(response))


def test_the_sliders_ends_are_spheres_of_the_dishes_radius():
    lower = b.slider_outline(FAILING)[: b.ARC_POINTS]
    x, z = lower.T
    centre = z.min() + FAILING.radius
    np.testing.assert_allclose(np.hypot(x, z - centre), FAILING.radius, rtol=1e-12)


def test_a_mirrored_pulse_gives_the_mirrored_picture(failure):
    mirrored = simulate_one(FAILING, Pulse(2.5, -0.5 * GRAVITY))
    time = failure.margins.first_touch_time
    one, other = slider(failure, time), slider(mirrored, time)
    # Mirrored, each arc is run through the other way.
    arcs = other.reshape(2, b.ARC_POINTS, 2)[:, ::-1].reshape(-1, 2) * (-1.0, 1.0)
    np.testing.assert_allclose(arcs, one, rtol=0.0, atol=1e-4)


def test_the_vertices_that_press_on_a_rim_are_marked_while_a_rim_carries_force(failure):
    motion = Motion(failure)
    _, rims = motion.contacts(motion.steps)
    for time, rim in zip(motion.steps.tolist(), rims, strict=True):
        states = b.vertex_states(motion, time)
        assert (b.ON_RIM in states[:2]) == (rim[0] > 0.0)
        assert (b.ON_RIM in states[2:]) == (rim[1] > 0.0)


def test_a_vertex_that_escaped_over_a_rim_is_marked_as_that():
    bearing = Bearing.from_table(2.676, 0.05454, 0.5592, 0.3724, 0.05096, 56.82, 1.737e9)
    response = simulate_one(bearing, Pulse(3.178, 0.618 * GRAVITY))
    motion = Motion(response)
    assert response.cause_name == "escape"
    assert b.OVER_RIM in b.vertex_states(motion, response.t[-1])
    assert b.OVER_RIM not in b.vertex_states(motion, response.t[-2])


def test_stills_show_rest_touch_the_way_and_the_end(failure, impact, no_impact):
    names = [re.findall(r"<text[^>]*>(.*?), t = ", stills(one, "a bearing")) for one in (failure, impact, no_impact)]
    assert names[0] == ["at rest", "first rim touch", "half-way to failure", "failure"]
    assert names[1] == ["at rest", "first rim touch", "largest uplift", "end of the run"]
    assert names[2][-1] == "end of the run"


def test_a_response_without_motion_is_refused_with_the_reason():
    stuck = simulate_one(FAILING, Pulse(2.5, 0.5 * GRAVITY), tolerance=Tolerance(most_steps=1))
    short = Response(
        **{
            **vars(stuck),
            "t": stuck.t[:1],
            "q": stuck.q[:1],
            "v": stuck.v[:1],
            "a": stuck.a[:1],
            "rims": stuck.rims[:1],
        }
    )
    with pytest.raises(InputError, match="no motion to draw"):
        m.plot_response(short)


def test_drawing_leaves_the_users_settings_alone(failure):
    def settings():
        # Asking for the backend would choose one.
        return {name: matplotlib.rcParams[name] for name in matplotlib.rcParams if not name.startswith("backend")}

    before = settings()
    m.plot_histories(failure)
    assert settings() == before


def test_matplotlib_is_imported_by_the_pictures_alone_and_pyplot_by_nothing():
    program = (
        "import sys, activefail.seismic.bearing, activefail.pages.figures.style\n"
        "assert 'matplotlib' not in sys.modules\n"
        "import activefail.seismic.figures.motion, activefail.seismic.figures.animation\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=PATIENCE)


@pytest.mark.parametrize("name", ["RSN953_NORTHR_MUL009", "W" * 255])
def test_the_title_of_a_bearing_under_a_record_fits_into_the_figure(name: str) -> None:
    motion = Accelerogram(3.0 * np.sin(np.arange(0.0, 6.0, 0.02)), 0.02, name)
    figure = m.titled_figure(simulate_one(FAILING, motion), 8.0, 5.0)
    assert name[:16] in words(figure)
    for text in figure.texts:
        box = text.get_window_extent()
        assert figure.bbox.x0 <= box.x0
        assert box.x1 <= figure.bbox.x1
        assert text.get_fontsize() > 5.0
