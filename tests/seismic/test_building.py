"""The building of campaigns/building.py: its modes, its coupling to the bearing, its energy, and its campaign."""

import math
import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from commandline import activefail, table
from scipy.linalg import eigh

from activefail import simulate_one
from activefail.seismic.bearing import Accelerogram, Bearing, Pulse, Response
from activefail.seismic.bearing.dynamics import equilibrium, static_contact
from activefail.seismic.bearing.pulse import ground_acceleration
from activefail.simulators.user_code import load_function
from activefail.space.space import Array

CAMPAIGNS = Path(__file__).parents[2] / "campaigns"
TABLE = ("T_b", "mu", "D_tot", "h_sl_ratio", "h_rim_ratio", "p", "k")

DESIGN = {
    "T_b": 4.0,
    "mu": 0.06,
    "D_tot": 0.6,
    "h_sl_ratio": 0.6,
    "h_rim_ratio": 0.1,
    "p": 45.0,
    "k": 2e9,
    "T_p": 2.5,
    "A_p": 0.15,
    "T_s": 0.5,
    "storeys": 3.0,
    "storey_height": 3.5,
    "damping": 0.02,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the module in which numba stores what it compiles, for all that load it: compiling takes seconds."""
    folder = tmp_path_factory.mktemp("campaigns")
    code = (CAMPAIGNS / "building.py").read_text(encoding="utf-8")
    assert code.count("@njit(error_model=") == code.count("@njit")
    (folder / "building.py").write_text(code.replace("@njit(", "@njit(cache=True, "), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def building(folder: Path) -> ModuleType:
    """The module as a campaign loads it: from its folder."""
    run, _ = load_function("building:run", folder, "test")
    return sys.modules[run.__module__]


def of(**changes: float) -> dict[str, float]:
    return DESIGN | changes


def on_a_rigid_mass(design: dict[str, float]) -> Response:
    bearing = Bearing.from_table(*(design[name] for name in TABLE))
    return simulate_one(bearing, Pulse.from_table(design["T_p"], design["A_p"]), to_the_end=True)


def chain(n: int, storey: float = 1.0, base: float = math.inf) -> tuple[Array, Array]:
    """Mass and stiffness matrices of n unit masses on springs, on a fixed base or on one of unit mass with a spring."""
    fixed = math.isinf(base)
    springs = [storey] * n if fixed else [base, *[storey] * n]
    size = len(springs)
    K = np.diag(springs) + np.diag([*springs[1:], 0.0])
    K -= np.diag(springs[1:], 1) + np.diag(springs[1:], -1)
    return np.eye(size), K


# --- the shear building ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 8])
def test_the_modes_in_closed_form_are_those_of_the_matrices(building: ModuleType, n: int) -> None:
    shear = building.shear_building(n, 0.7)
    M, K = chain(n)
    values, phi = eigh(K, M)
    scale = (2.0 * math.pi / 0.7) ** 2 / values[0]
    assert shear.omega == pytest.approx(np.sqrt(scale * values), rel=1e-10)
    participation = phi.sum(axis=0)  # the eigenvectors have unit mass
    assert shear.shape == pytest.approx(participation * phi, abs=1e-10)
    assert shear.mass == pytest.approx(participation**2, rel=1e-8)


@pytest.mark.parametrize("n", [1, 3])
def test_under_a_steady_acceleration_a_storey_gives_way_to_the_floors_above_it(building: ModuleType, n: int) -> None:
    b = building.building_of(of(storeys=float(n)))
    steady = 1.7
    D = -steady / np.array(b.stiffness)  # of the modes at rest on a base that accelerates so
    storey_stiffness = (
        2.0 * math.pi / DESIGN["T_s"] / (2.0 * math.sin(math.pi / (4 * n + 2)))
    ) ** 2  # over a floor's mass
    above = np.arange(n, 0, -1)
    assert b.drift @ D == pytest.approx(-above * steady / storey_stiffness / DESIGN["storey_height"], rel=1e-10)
    # All floors then go along with the base.
    assert b.floor @ (b.stiffness * D) == pytest.approx(np.full(n, steady), rel=1e-10)


# --- its coupling to the bearing ---------------------------------------------------------------------------------


def linearised(building: ModuleType, b: Any, t: float, q: Array, v: Array) -> tuple[Array, Array, Array]:
    size = len(q)
    out = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    building.linearise(b, t, q, v, *out)
    return out


def accelerations(building: ModuleType, b: Any, t: float, q: Array, v: Array) -> Array:
    out = np.empty(len(q))
    building.accelerate(b, t, q, v, out)
    return out


def test_the_derivatives_are_those_of_the_accelerations(building: ModuleType) -> None:
    b = building.building_of(DESIGN)
    rng = np.random.default_rng(0)
    for x in (0.1, 0.62):  # in the dish, and at the rim
        q = np.array([*equilibrium(b.bearing), 0.01, -0.002, 0.001])
        q[0], q[3] = 0.5 * x, x
        v = 0.1 * rng.standard_normal(8)
        by_q, by_v, by_t = linearised(building, b, 0.3, q, v)
        for i in range(8):
            for derivative, step, move_q, move_v in ((by_q, 1e-7, 1, 0), (by_v, 1e-5, 0, 1)):
                d = np.zeros(8)
                d[i] = step
                ahead = accelerations(building, b, 0.3, q + move_q * d, v + move_v * d)
                behind = accelerations(building, b, 0.3, q - move_q * d, v - move_v * d)
                expected = (ahead - behind) / (2.0 * step)
                assert derivative[:, i] == pytest.approx(expected, rel=1e-3, abs=1e-4 * np.abs(derivative).max())
        later, earlier = (accelerations(building, b, 0.3 + s, q, v) for s in (1e-5, -1e-5))
        assert by_t == pytest.approx((later - earlier) / 2e-5, rel=1e-4, abs=1e-2)


@pytest.mark.parametrize("T_s", [0.3, 1.0])
def test_small_swings_have_the_periods_of_a_chain_on_the_pendulum_s_spring(building: ModuleType, T_s: float) -> None:
    # Hardly any friction; contacts so stiff that the slider does not rock.
    design = of(T_s=T_s, mu=1e-12, k=1e12, damping=0.0, h_sl_ratio=0.33)
    b = building.building_of(design)
    q, still = np.array([*equilibrium(b.bearing), 0.0, 0.0, 0.0]), np.zeros(8)
    by_q, _, _ = linearised(building, b, 10.0, q, still)
    actual = np.sqrt(np.sort(-np.linalg.eigvals(by_q).real)[:4])
    radius, half = b.bearing.bottom.radius, b.bearing.half_width
    _, sunk = static_contact(b.bearing.bottom, half, b.bearing.plate_mass * 9.81)
    length = 2.0 * math.sqrt((radius + sunk) ** 2 - half**2) - 2.0 * b.bearing.half_height
    storey = (2.0 * math.pi / T_s / (2.0 * math.sin(math.pi / 14.0))) ** 2
    M, K = chain(3, storey, 4.0 * 9.81 / length)  # the weight of four masses, over one
    # The slider's own mass is in neither: a part in three thousand of what it carries.
    assert actual == pytest.approx(np.sqrt(eigh(K, M, eigvals_only=True)), rel=1e-3)


@pytest.mark.parametrize(("A_p", "outcome"), [(0.12, "no_impact"), (0.2, "impact"), (0.3, "failure"), (0.5, "failure")])
def test_a_stiff_building_does_to_its_bearing_what_a_rigid_mass_does(
    building: ModuleType, A_p: float, outcome: str
) -> None:
    design = of(A_p=A_p, T_s=0.05)
    rigid, response = on_a_rigid_mass(design), building.simulate(design)
    assert rigid.outcome_name == outcome
    assert response.touched == (outcome != "no_impact")
    assert response.cause == rigid.cause_name
    assert response.peak_displacement == pytest.approx(
        rigid.margins.peak_displacement_ratio * design["D_tot"], rel=0.01
    )
    if outcome != "failure":
        # Stiff storeys hardly give way, and every floor feels what the base does.
        assert response.peak_drift < 2e-4


def test_a_flexible_building_answers_as_one_on_the_motion_of_its_base(building: ModuleType) -> None:
    # The modes on the base's recorded acceleration, by another method: scipy.signal's linear filter of each oscillator.
    from scipy.signal import lsim

    design = of(T_s=0.8)
    b = building.building_of(design)
    response = building.simulate(design, 1e-6, 100_000)
    history = response.history
    t = np.linspace(history[0, 0], history[-1, 0], 20_001)
    base = np.array([accelerations(building, b, row[0], row[1:9].copy(), row[9:].copy())[3] for row in history])
    ground = np.array([ground_acceleration(s, *b.bearing.motion) for s in history[:, 0]])
    absolute = np.interp(t, history[:, 0], base + ground)
    for j in range(3):
        system = ([-1.0], [1.0, b.damping[j], b.stiffness[j]])
        _, D, _ = lsim(system, absolute, t - t[0])
        actual = np.interp(t, history[:, 0], history[:, 6 + j])
        assert np.abs(actual - D).max() < 0.02 * np.abs(D).max(), j


# --- records -----------------------------------------------------------------------------------------------------


def under_record(design: dict[str, float]) -> dict[str, float]:
    """A design that names no pulse."""
    return {name: value for name, value in design.items() if name not in ("T_p", "A_p")}


@pytest.mark.slow
@pytest.mark.parametrize("A_p", [0.15, 0.3, 0.6])
def test_a_sampled_pulse_moves_the_building_as_the_pulse_does(building: ModuleType, A_p: float) -> None:
    design = of(A_p=A_p)
    t = np.arange(0.0, 3.0 * design["T_p"], 0.005) - 1.5 * design["T_p"]
    samples = np.array([ground_acceleration(time, A_p * 9.81, design["T_p"]) for time in t])
    pulse = building.simulate(design)
    record = building.simulate(under_record(design), record=Accelerogram(samples, 0.005))
    assert (record.cause, record.touched) == (pulse.cause, pulse.touched)
    assert record.peak_displacement == pytest.approx(pulse.peak_displacement, rel=2e-3)
    assert record.peak_drift == pytest.approx(pulse.peak_drift, rel=0.02)
    assert record.energy_error < 1e-3


def test_a_mirrored_record_moves_the_building_to_the_other_side(building: ModuleType) -> None:
    design = under_record(DESIGN)
    rng = np.random.default_rng(0)
    record = Accelerogram(
        3.0 * np.convolve(rng.standard_normal(800), np.exp(-np.arange(0.0, 1.0, 0.02) / 0.2)) / 5.0, 0.02
    )
    one, other = (building.simulate(design, record=record.scaled(sign)) for sign in (1.0, -1.0))
    assert one.peak_displacement > 0.05
    assert other.peak_displacement == pytest.approx(one.peak_displacement, rel=1e-6)
    assert other.peak_drift == pytest.approx(one.peak_drift, rel=1e-6)


# --- energy and order --------------------------------------------------------------------------------------------


def free(building: ModuleType, damping: float) -> tuple[Any, Array, Array, float]:
    """A building that is let go with bent storeys, without a pulse; its energy above rest [J]."""
    b = building.building_of(of(A_p=0.0, damping=damping))
    q, v = np.array([*equilibrium(b.bearing), 0.0, 0.0, 0.0]), np.zeros(8)
    rest = building.energy_and_events(b, 0.0, q, v)[0]
    q[5:] = 0.03, 0.002, 0.0005
    return b, q, v, building.energy_and_events(b, 0.0, q, v)[0] - rest


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.3])
def test_what_bent_storeys_hold_is_what_friction_and_damping_take(building: ModuleType, damping: float) -> None:
    b, q, v, energy = free(building, damping)
    assert energy == pytest.approx(0.5 * float(np.sum(b.mass * b.stiffness * q[5:] ** 2)), rel=1e-9)
    rest = building.energy_and_events(b, 0.0, np.array([*q[:5], 0.0, 0.0, 0.0]), v)[0]
    h, stored, lost = 5e-4, [energy], 0.0
    end_q, end_v = np.empty(8), np.empty(8)
    power = building.energy_and_events(b, 0.0, q, v)[1]
    for step in range(2000):
        building.rosenbrock_step(b, 20.0 + step * h, q, v, h, end_q, end_v)
        q[:], v[:] = end_q, end_v
        now = building.energy_and_events(b, 20.0, q, v)
        lost += 0.5 * h * (power + now[1])
        power = now[1]
        stored.append(now[0] - rest)
    assert np.max(np.diff(stored)) < 1e-6 * energy  # it never grows
    assert stored[-1] < (0.7 if damping else 0.99) * energy
    assert stored[-1] + lost == pytest.approx(energy, rel=2e-3)


def test_a_step_has_order_three(building: ModuleType) -> None:
    # Friction over 5 cm/s instead of 1 mm/s, so that there is a stretch without a corner.
    b = building.building_of(of(A_p=0.3, k=2e6))
    smooth = b.bearing.bottom._replace(friction_velocity=0.05)
    b = b._replace(bearing=b.bearing._replace(bottom=smooth, top=smooth))
    ends = []
    for steps in (40, 80, 160, 1280):
        q, v = np.array([*equilibrium(b.bearing), 0.005, 0.001, 0.0]), np.zeros(8)
        end_q, end_v = np.empty(8), np.empty(8)
        for step in range(steps):
            h = 0.1 / steps
            building.rosenbrock_step(b, -0.9 + step * h, q, v, h, end_q, end_v)
            q[:], v[:] = end_q, end_v
        ends.append(q[[3, 5, 6]].copy())
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (orders > 2.6).all(), (orders, errors)


# --- outcomes and the campaign -----------------------------------------------------------------------------------


def consistent(outcome: str, margins: dict[str, float]) -> None:
    failed = margins["bearing_failed"] == 1.0 or margins["peak_drift"] > 0.02
    assert outcome == ("failure" if failed else "damage" if margins["peak_drift"] > 0.005 else "safe")
    if margins["bearing_failed"]:
        assert margins["peak_displacement_ratio"] > 0.9
        assert margins["peak_rim_force_ratio"] > 0.0
    assert margins["energy_error"] < 2e-3


@pytest.mark.parametrize(
    "wrong", [{"storeys": 2.5}, {"storeys": 0.0}, {"T_s": 0.0}, {"storey_height": -1.0}, {"mu": 0.0}]
)
def test_what_is_no_building_is_refused(building: ModuleType, wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        building.run(of(**wrong))


def test_the_campaign_runs_from_its_file_and_its_table_is_consistent(
    building: ModuleType, folder: Path, tmp_path: Path
) -> None:
    settings = (CAMPAIGNS / "building.toml").read_text(encoding="utf-8")
    for name, value in (("initial = 120", "initial = 16"), ("size = 500", "size = 0")):
        assert name in settings
        settings = settings.replace(name, value)
    (folder / "building.toml").write_text(settings, encoding="utf-8")
    result = activefail("run", folder / "building.toml", "--out", tmp_path / "run", "--budget", "20", "--workers", "1")
    assert result.code == 0, result.err
    assert activefail("export", tmp_path / "run", "--csv", tmp_path / "all.csv").code == 0
    rows = table(tmp_path / "all.csv")
    assert [row["origin"] for row in rows] == ["seed"] * 16 + ["active"] * 4
    space = tomllib.loads(settings)["space"]
    margins = tomllib.loads(settings)["simulator"]["margins"]
    for row in rows:
        consistent(row["outcome"], {name: float(row[name]) for name in margins})
    assert len({row["outcome"] for row in rows}) > 1
    # The table holds what the function says of its designs.
    fixed = {name: value["value"] for name, value in space.items() if "value" in value}
    for row in rows[::5]:
        answer = building.run({name: float(row[name]) for name in space if name not in fixed} | fixed)
        assert answer["outcome"] == row["outcome"]
        assert {name: float(row[name]) for name in margins} == answer["margins"]


def test_the_comparison_with_a_rigid_mass_in_the_docs_runs(
    building: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (CAMPAIGNS.parent / "docs" / "building.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert "latin_hypercube(1000," in block
    monkeypatch.chdir(CAMPAIGNS.parent)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setitem(sys.modules, "building", building)  # compiled already
    exec(block.replace("latin_hypercube(1000,", "latin_hypercube(20,"), {})
    lines = capsys.readouterr().out.splitlines()
    assert sum(int(line.split()[0]) for line in lines) == 20
    assert any("rigid mass: failure" in line for line in lines)
