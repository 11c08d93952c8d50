"""Draw the pictures of the first tutorial: `python docs/images/draw.py`."""

from pathlib import Path

from activefail.seismic.bearing import Bearing, Pulse, simulate_one
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.views.film import stills

HERE = Path(__file__).parent

failing = Bearing.from_table(T_b=4.0, mu=0.06, D_tot=0.6, h_sl_ratio=0.6, h_rim_ratio=0.1, p=45.0, k=2e9)
surviving = Bearing.from_table(T_b=4.0, mu=0.043, D_tot=0.544, h_sl_ratio=0.84, h_rim_ratio=0.167, p=35.6, k=7.35e8)
for name, bearing, pulse in (
    ("failing", failing, Pulse(2.5, 0.5 * GRAVITY)),
    ("surviving", surviving, Pulse(4.44, 0.178 * GRAVITY)),
):
    drawn = stills(simulate_one(bearing, pulse, to_the_end=True), f"A {name} bearing")
    # Pages may be dark; the lines are not.
    (HERE / f"{name}.svg").write_text(drawn.replace("<svg ", '<svg style="background: white" ', 1))
