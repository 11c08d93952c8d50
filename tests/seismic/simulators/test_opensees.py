"""The campaign on OpenSees: its program, the campaign itself, and the bearing compared with OpenSees' element."""

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commandline import activefail, record, table

from activefail.campaign.settings import read_settings
from activefail.seismic.bearing import (
    TABLE_1,
    Accelerogram,
    Bearing,
    Model,
    Pulse,
    Tolerance,
    simulate,
    simulate_one,
    simulate_records,
)
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.pulse import ground_acceleration
from activefail.seismic.motions.accelerogram_sets import read_record_set
from activefail.space.space import Array

CAMPAIGNS = Path(__file__).parents[3] / "campaigns"
PROGRAM = CAMPAIGNS / "opensees_model.py"
DESIGN = {"--t-b": 4.0, "--mu": 0.06, "--d-tot": 0.6, "--t-p": 1.0, "--a-p": 0.3}


def program(interpreter: str, *extra: str | Path, **changed: float) -> subprocess.CompletedProcess[str]:
    """The program on DESIGN with these options changed."""
    design = DESIGN | {f"--{name.replace('_', '-')}": value for name, value in changed.items()}
    words = [word for name, value in design.items() for word in (name, repr(value))]
    return subprocess.run([interpreter, PROGRAM, *words, *extra], capture_output=True, text=True, check=False)


def answer_of(interpreter: str, *extra: str | Path, **changed: float) -> dict[str, object]:
    done = program(interpreter, *extra, **changed)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert isinstance(answer, dict)
    return answer


# --- the program -------------------------------------------------------------------------------------------------


def test_without_openseespy_the_program_says_what_to_install_and_where(tmp_path: Path) -> None:
    (tmp_path / "openseespy").mkdir()
    (tmp_path / "openseespy" / "__init__.py").write_text("raise RuntimeError('libblas.so.3: cannot open')\n")
    words = [sys.executable, PROGRAM, *(str(word) for pair in DESIGN.items() for word in pair)]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"opensees_model.py: {sys.executable} cannot import openseespy (libblas.so.3")
    assert "pip install openseespy" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_answer_is_written_to_the_file_and_nothing_else_to_stdout(opensees: str, tmp_path: Path) -> None:
    done = program(opensees, "--out", tmp_path / "answer.json", "--history", tmp_path / "motion.csv")
    assert (done.returncode, done.stdout) == (0, "")
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer == answer_of(opensees)
    motion = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1)
    assert motion[0].tolist() == [-1.5, 0.0, 0.0]
    assert motion[-1, 0] >= 1.5 + 2.5 * 4.0
    assert np.abs(motion[:, 2]).max() == answer["margins"]["peak_shear_ratio"]
    assert abs(motion[-1, 1]) == answer["margins"]["residual_displacement"]


@pytest.mark.parametrize(("share", "moves"), [(0.98, False), (1.1, True)])
def test_the_mass_moves_once_the_pulse_exceeds_friction(opensees: str, share: float, moves: bool) -> None:
    # On a surface of radius L the friction coefficient is a little larger than on the dishes.
    radius, height = 0.5 * 9.81 * (4.0 / (2.0 * math.pi)) ** 2, 0.8 * 0.30
    half = math.asin(0.15 / radius)
    length = 2.0 * radius * math.cos(half) - height
    friction = math.tan(math.asin(2.0 * radius * math.sin(math.atan(0.06)) / (length * math.cos(half))))
    margins = answer_of(opensees, a_p=share * friction)["margins"]
    assert isinstance(margins, dict)
    assert (margins["peak_displacement_ratio"] > 1e-4) == moves
    # Nothing slides: the shear is the ground's acceleration.
    assert moves or margins["peak_shear_ratio"] == pytest.approx(share * friction, rel=0.01)


def test_impact_is_a_displacement_that_reaches_the_rim(opensees: str) -> None:
    free = answer_of(opensees)
    assert free["outcome"] == "safe"
    ratio = free["margins"]["peak_displacement_ratio"]  # type: ignore[index]
    assert 0.1 < ratio < 1.0
    # The capacity is nearly in proportion to D_tot.
    for share, outcome in ((1.05, "safe"), (0.95, "impact")):
        answer = answer_of(opensees, d_tot=0.6 * ratio * share)
        assert answer["outcome"] == outcome
        assert set(answer["margins"]) - {"peak_displacement_ratio", "peak_shear_ratio"} == {  # type: ignore[call-overload]
            "residual_displacement" if outcome == "safe" else "touch_velocity"
        }


def test_a_pulse_as_a_record_moves_the_mass_as_the_pulse(opensees: str, tmp_path: Path) -> None:
    assert program(opensees, "--history", tmp_path / "pulse.csv").returncode == 0
    t = -1.5 + 0.0025 * np.arange(1201)  # the steps that the program takes for the pulse
    a = [ground_acceleration(x, 0.3 * GRAVITY, 1.0) for x in t]
    np.savetxt(tmp_path / "ground.csv", np.column_stack([t, a]), delimiter=",")
    words = ["--t-b", "4", "--mu", "0.06", "--d-tot", "0.6", "--record", tmp_path / "ground.csv"]
    command = [opensees, PROGRAM, *words, "--history", tmp_path / "record.csv"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    one, other = (np.loadtxt(tmp_path / name, delimiter=",", skiprows=1) for name in ("record.csv", "pulse.csv"))
    assert one[0, 0] == other[0, 0] == -1.5
    assert one[-1, 0] == pytest.approx(1.5 + 2.5 * 4.0, abs=0.01)
    peak = np.abs(other[:, 1]).max()
    assert np.interp(other[:, 0], one[:, 0], one[:, 1]) == pytest.approx(other[:, 1], abs=1e-3 * peak)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0,1\n", "must have two numbers in each of at least two lines, got shape (1, 2)"),
        ("0,1\n1,1\n3,1\n", "times must rise by equal intervals"),
    ],
)
def test_a_record_that_is_none_is_refused(opensees: str, tmp_path: Path, text: str | None, says: str) -> None:
    if text is not None:
        (tmp_path / "ground.csv").write_text(text)
    words = ["--t-b", "4", "--mu", "0.06", "--d-tot", "0.6", "--record", tmp_path / "ground.csv"]
    done = subprocess.run([opensees, PROGRAM, *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert says in done.stderr
    assert "Traceback" not in done.stderr


def test_pulse_and_record_exclude_each_other(opensees: str, tmp_path: Path) -> None:
    done = program(opensees, "--record", tmp_path / "ground.csv")
    assert done.returncode == 2
    assert "--t-p and --a-p are required without --record, and cannot be combined with it" in done.stderr


@pytest.mark.parametrize(
    ("changed", "code", "says"),
    [
        ({"t_b": 1.0}, 1, "a dish must be less than a hemisphere"),
        ({"mu": -0.1}, 2, "must be positive and finite, got -0.1"),
    ],
)
def test_a_design_that_cannot_be_built_is_refused(
    opensees: str, changed: dict[str, float], code: int, says: str
) -> None:
    done = program(opensees, **changed)
    assert (done.returncode, done.stdout) == (code, "")
    assert says in done.stderr
    assert "Traceback" not in done.stderr


# --- the campaign ------------------------------------------------------------------------------------------------


def test_the_campaign_names_the_margins_that_the_program_reports(opensees: str) -> None:
    names = {name for d_tot in (0.1, 0.8) for name in answer_of(opensees, d_tot=d_tot)["margins"]}  # type: ignore[attr-defined]
    named = read_settings(CAMPAIGNS / "opensees.toml").simulator
    assert names == set(named.margins)  # type: ignore[union-attr]


def test_the_campaign_runs_is_resumed_and_its_failures_are_told(opensees: str, tmp_path: Path) -> None:
    shutil.copy(PROGRAM, tmp_path)
    text = (CAMPAIGNS / "opensees.toml").read_text(encoding="utf-8")
    for shipped, smaller in (
        ("python {here}", f"{opensees} {{here}}"),
        ("initial = 60", "initial = 6"),
        ("budget = 120", "budget = 8"),
        ("batch = 10", "batch = 2"),
    ):
        assert shipped in text
        text = text.replace(shipped, smaller)
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    run = tmp_path / "run"
    answer = activefail("run", tmp_path / "mine.toml", "--out", run, "--budget", "6")
    assert answer.code == 0, answer.err
    answer = activefail("resume", run, "--budget", "8", "--code", tmp_path)
    assert answer.code == 0, answer.err
    whole = activefail("run", tmp_path / "mine.toml", "--out", tmp_path / "whole")
    assert whole.code == 0, whole.err
    first, second = ([row | {"folder": ""} for row in record(of)] for of in (run, tmp_path / "whole"))
    assert first == second
    rows = table(run.with_suffix(".csv"))
    assert {row["outcome"] for row in rows} == {"safe", "impact"}
    for row in rows:
        assert (float(row["peak_displacement_ratio"]) >= 1.0) == (row["outcome"] == "impact")
        assert (row["touch_velocity"] == "") == (row["outcome"] == "safe")

    (tmp_path / "openseespy.py").write_text("raise ImportError('no licence for it')\n")
    broken = activefail("resume", run, "--budget", "20", "--code", tmp_path)
    assert broken.code == 1
    assert "cannot import openseespy" in broken.err
    assert "no licence for it" in broken.err


# --- the bearing compared with OpenSees' element --------------------------------------------------------------------


@pytest.fixture(scope="module")
def untouched() -> Array:
    """Twenty designs of Table 1 that meet no rim and move by some centimetres, (20, 9)."""
    X = TABLE_1.latin_hypercube(100, np.random.default_rng(20261))
    answers = simulate(X)
    peak = answers.margin("peak_displacement_ratio") * X[:, 2]
    # Near the rim the two may part: a vertex may touch in one alone.
    return X[(answers.outcome == 0) & (peak > 0.05) & (peak < 0.85 * X[:, 2])][:20]


def of_bearing(row: Array, model: Model, stiffness: float, ground: Accelerogram | None = None) -> tuple[Array, Array]:
    """Times [s] and displacements [m] of the bearing, with contacts so many times as stiff, under pulse or record."""
    design = row.copy()
    design[6] *= stiffness
    bearing, motion = Bearing.from_row(design.tolist(), model.slider_diameter), ground or Pulse.from_table(*design[7:])
    response = simulate_one(bearing, motion, model, Tolerance(1e-5), to_the_end=True)
    assert response.outcome_name == "no_impact"
    return response.t, response.q[:, 3]


ONE_AFTER_ANOTHER = """
import json, runpy, sys
for sys.argv in json.load(sys.stdin):
    runpy.run_path(sys.argv[0], run_name="__main__")
"""


def of_opensees(
    interpreter: str, rows: list[Array], folder: Path, grounds: list[Accelerogram] | None = None
) -> list[tuple[Array, Array]]:
    """Times [s] and displacements [m] of the program on each design, all in one process, which is loaded once."""
    commands, files = [], [folder / f"motion-{number}.csv" for number in range(len(rows))]
    for number, (row, file) in enumerate(zip(rows, files, strict=True)):
        T_b, mu, D_tot, h_sl_ratio, _, _, _, T_p, A_p = row.tolist()
        design: dict[str, float | Path] = {"t_b": T_b, "mu": mu, "d_tot": D_tot, "h_sl_ratio": h_sl_ratio}
        if grounds is None:
            design |= {"t_p": T_p, "a_p": A_p}
        else:
            ground, record = grounds[number], folder / f"ground-{number}.csv"
            times = ground.dt * np.arange(len(ground.acceleration))
            np.savetxt(record, np.column_stack([times, ground.acceleration]), delimiter=",")
            design["record"] = record
        words = [str(word) for name, value in design.items() for word in (f"--{name.replace('_', '-')}", value)]
        commands.append([str(PROGRAM), *words, "--history", str(file)])
    done = subprocess.run(
        [interpreter, "-c", ONE_AFTER_ANOTHER], input=json.dumps(commands), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    motions = [np.loadtxt(file, delimiter=",", skiprows=1) for file in files]
    return [(motion[:, 0], motion[:, 1]) for motion in motions]


def differences(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[float, float]:
    """Of the peaks and, the largest, of the histories, over the other's peak."""
    peak = np.abs(other[1]).max()
    within = other[0] <= one[0][-1]
    apart = np.abs(np.interp(other[0][within], *one) - other[1][within]).max()
    return abs(np.abs(one[1]).max() - peak) / peak, apart / peak


def test_the_rigid_bearing_moves_as_opensees_friction_pendulum(opensees: str, untouched: Array, tmp_path: Path) -> None:
    assert len(untouched) == 20
    # Coulomb friction and rigid contacts, as far as either model goes.
    rigid = Model(friction_velocity=1e-5)
    bearings = [of_bearing(row, rigid, 1e4) for row in untouched]
    pairs = list(zip(bearings, of_opensees(opensees, list(untouched), tmp_path), strict=True))
    peak, history = np.array([differences(*pair) for pair in pairs]).T
    assert np.median(peak) < 0.003
    assert np.median(history) < 0.008
    # The element takes x/L for the slope, by which the pendulum's force is x/L/(1 − (x/L)²) of the weight and not
    # x/L/√(1 − (x/L)²): the motions may part by what it is too stiff at the peak (docs/opensees.md).
    reach = [np.abs(x).max() / rigid_length(row) for row, (_, (_, x)) in zip(untouched, pairs, strict=True)]
    excess = 1.0 / np.sqrt(1.0 - np.square(reach)) - 1.0
    assert np.all(peak < 0.005 + excess)
    assert np.all(history < 0.01 + excess)
    assert np.median(excess) < 0.01


def rigid_length(row: Array) -> float:
    """L of a design, between the centres of the circles on which the vertices move [m]."""
    bearing = Bearing.from_row(row.tolist(), 0.30)
    return 2.0 * math.sqrt(bearing.radius**2 - 0.15**2) - bearing.slider_height


def synthetic(rng: np.random.Generator, dt: float = 0.01) -> Accelerogram:
    """A pulse with filtered noise in an envelope, of 0.2 g."""
    t, period = np.arange(0.0, 20.0, dt), rng.uniform(1.0, 3.0)
    noise = np.convolve(rng.standard_normal(len(t)), np.exp(-np.arange(0.0, 1.0, dt) / 0.1), mode="same")
    noise *= np.exp(-0.5 * ((t - 8.0) / 3.0) ** 2)
    a = np.array([ground_acceleration(x - 8.0, 1.0, period) for x in t]) + 0.7 * noise / np.abs(noise).max()
    return Accelerogram(0.2 * GRAVITY * a / np.abs(a).max(), dt)


def shaken(grounds: list[Accelerogram], rng: np.random.Generator) -> list[tuple[Array, Accelerogram]]:
    """A random design of Table 1 for each record, with the record scaled so that the bearing moves but meets no rim."""
    found = []
    for row, ground in zip(TABLE_1.latin_hypercube(len(grounds), rng), grounds, strict=True):
        scaled = [ground.scaled(factor) for factor in (2.0, 1.5, 1.0, 0.7, 0.5)]
        answers = simulate_records(np.tile(row[:7], (len(scaled), 1)), scaled, to_the_end=True)
        ratio = answers.margin("peak_displacement_ratio")
        fit = np.flatnonzero((answers.outcome == 0) & (ratio * row[2] > 0.05) & (ratio < 0.85))
        found += [(row, scaled[k]) for k in fit[:1]]
    return found


@pytest.mark.parametrize("name", ["synthetic", pytest.param("farfield", marks=pytest.mark.needs("records"))])
def test_the_rigid_bearing_moves_as_opensees_friction_pendulum_under_records(
    name: str, opensees: str, tmp_path: Path
) -> None:
    rng = np.random.default_rng(20262)
    if name == "synthetic":
        grounds = [synthetic(rng) for _ in range(10)]
    else:
        grounds = [record.motion for record in read_record_set(Path(name)).records[::6]]
    cases = shaken(grounds, rng)
    assert len(cases) >= 6
    rigid = Model(friction_velocity=1e-5)
    bearings = [of_bearing(row, rigid, 1e4, ground) for row, ground in cases]
    rows, scaled = [row for row, _ in cases], [ground for _, ground in cases]
    pairs = list(zip(bearings, of_opensees(opensees, rows, tmp_path, scaled), strict=True))
    peak, history = np.array([differences(*pair) for pair in pairs]).T
    assert np.median(peak) < 0.005
    assert np.median(history) < 0.01
