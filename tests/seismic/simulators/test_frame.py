"""The frame of campaigns/frame.toml: the program against other solutions, its Tcl, its features, and its campaign."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import activefail
from scipy.signal import lsim

from activefail import create_run
from activefail.seismic.bearing.pulse import ground_acceleration
from activefail.simulators.placeholders import filled_file
from activefail.simulators.user_code import load_function

ROOT = Path(__file__).parents[3]
CAMPAIGNS = ROOT / "campaigns"
SPACE = tomllib.loads((CAMPAIGNS / "frame.toml").read_text(encoding="utf-8"))["space"]
FIXED = {name: entry["value"] for name, entry in SPACE.items() if "value" in entry}
DESIGN = {"T_b": 3.5, "mu": 0.06, "D_tot": 0.45, "Cy": 0.25}
DT = 0.02


def pulse(scale: float) -> list[float]:
    """A ground motion of six seconds, with a pulse of 2 s [m/s²]."""
    t = np.arange(0.0, 6.0, DT)
    return [scale * ground_acceleration(x - 2.5, 1.0, 2.0) for x in t.tolist()]


def design_with_record(folder: Path, scale: float, **changed: float) -> dict[str, Any]:
    """A design as a program finds it in `design.json`."""
    np.savetxt(folder / "record.txt", pulse(scale))
    record = {"record": str(folder / "record.txt"), "record_dt": DT}
    return FIXED | DESIGN | record | changed


def answer_of(interpreter: str, design: dict[str, Any], folder: Path) -> dict[str, Any]:
    (folder / "design.json").write_text(json.dumps(design))
    command = [interpreter, CAMPAIGNS / "frame_model.py", folder / "design.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout.splitlines()[-1])
    assert isinstance(answer, dict)
    return answer


# --- without openseespy --------------------------------------------------------------------------------------------


def test_program_and_tcl_read_the_same_quantities_and_have_the_same_constants() -> None:
    python = (CAMPAIGNS / "frame_model.py").read_text(encoding="utf-8")
    tcl = (CAMPAIGNS / "frame.tcl").read_text(encoding="utf-8")
    by_python = set(re.findall(r"\bd\.(\w+)", python)) | {"record_dt"}
    by_tcl = set(re.findall(r"\{(\w+)\}", tcl)) - {"1"}
    assert by_python == by_tcl
    assert by_tcl - {"record", "record_dt"} == {*DESIGN, *FIXED}
    for name, word in {
        "G": "g",
        "HINGE": "hinge",
        "MOBILISED": "mobilised",
        "PAD": "pad",
        "DIVERGED": "diverged",
        "TOLERANCE, ITERATIONS": "tolerance",
        "MOST_TROUBLE, DEEPEST": "mostTrouble",
    }.items():
        (of_python,) = re.findall(rf"^{name} = ([\d.e+-]+)", python, re.MULTILINE)
        (of_tcl,) = re.findall(rf"^set {word} ([\d.e+-]+)", tcl, re.MULTILINE)
        assert float(of_python) == float(of_tcl), name


def test_without_openseespy_the_program_says_what_to_install_and_where(tmp_path: Path) -> None:
    (tmp_path / "openseespy").mkdir()
    (tmp_path / "openseespy" / "__init__.py").write_text("raise RuntimeError('libblas.so.3: cannot open')\n")
    (tmp_path / "design.json").write_text(json.dumps(design_with_record(tmp_path, 1.0)))
    command = [sys.executable, CAMPAIGNS / "frame_model.py", tmp_path / "design.json"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"frame_model.py: {sys.executable} cannot import openseespy (libblas.so.3")
    assert "Traceback" not in done.stderr


def coarse(design: dict[str, float], motion: list[float]) -> tuple[float, float, float]:
    """What the coarse model answers: displacement, rim and drift, each over its limit."""
    features, _ = load_function("frame_coarse:features", CAMPAIGNS, "test")
    module = sys.modules[features.__module__]
    fixed = tuple({**FIXED, **design}[name] for name in module.QUANTITIES)
    of_design = (design[name] for name in ("T_b", "mu", "D_tot", "Cy"))
    found = module.respond(np.array(motion), DT, 1.0, *of_design, fixed)
    assert len(found) == 3
    return found


def test_the_coarse_model_is_linear_where_nothing_slides_yields_or_touches() -> None:
    # A light friction and a frame that is stiff and strong leave a linear oscillator.
    design = {"T_b": 3.0, "mu": 1e-9, "D_tot": 5.0, "Cy": 5.0, "T_s": 0.5, "damping": 0.0}
    motion = np.append(pulse(1.0), np.zeros(int(2.0 / DT)))  # and what follows the record
    displacement, rim, _ = coarse(design, motion.tolist())
    assert rim == 0.0
    w = 2.0 * math.pi / 3.0
    t = DT * np.arange(len(motion))
    _, x, _ = lsim(([-1.0], [1.0, 0.0, w * w]), motion, t)
    # The storey deforms a little: (0.11 s / 3 s)² of the period.
    assert displacement * 5.0 == pytest.approx(np.abs(x).max(), rel=0.02)


def test_the_coarse_model_collapses_by_rim_or_by_drift() -> None:
    free = coarse(DESIGN, pulse(2.0))
    assert max(free) < 1.0
    # A bearing of less capacity than the free motion touches; at a much stronger motion the rim breaks.
    touching = coarse({**DESIGN, "D_tot": 0.45 * 0.9 * free[0]}, pulse(2.0))
    assert touching[0] > 1.0
    assert touching[1] > 0.0
    assert coarse({**DESIGN, "D_tot": 0.1}, pulse(12.0))[1] > 1.0
    # Behind a rim that does not give way, a weak frame drifts too far.
    weak = {**DESIGN, "D_tot": 0.1, "Cy": 0.05, "rim_strength": 10.0}
    assert coarse(weak, pulse(12.0))[2] > 1.0


def test_the_coarse_model_collapses_at_its_capacity() -> None:
    features, _ = load_function("frame_coarse:features", CAMPAIGNS, "test")
    module = sys.modules[features.__module__]
    fixed = tuple(FIXED[name] for name in module.QUANTITIES)
    of_design = [DESIGN[name] for name in ("T_b", "mu", "D_tot", "Cy")]
    capacity = module.capacity(np.array(pulse(2.0)), DT, 1.0, *of_design, fixed)  # in multiples of this motion
    assert max(coarse(DESIGN, pulse(2.0 * 0.97 * capacity))[1:]) < 1.0
    assert max(coarse(DESIGN, pulse(2.0 * 1.03 * capacity))[1:]) > 1.0


def records_in(folder: Path) -> None:
    """Three records in two events, as a set."""
    (folder / "records").mkdir()
    lines = ["file,unit,event,dt"]
    for name, scale, event in (("a", 3.0, "one"), ("b", -3.0, "one"), ("c", 4.0, "two")):
        motion = np.array(pulse(scale))
        motion += 0.3 * np.sin(np.arange(len(motion)) * (0.4 if name == "c" else 0.9))
        np.savetxt(folder / "records" / f"{name}.txt", motion)
        lines.append(f"{name}.txt,m/s2,{event},{DT}")
    (folder / "records" / "records.csv").write_text("\n".join(lines) + "\n")


def campaign_in(folder: Path, *changes: tuple[str, str]) -> Path:
    """The shipped campaign with records of its own and these changes, and the code beside it."""
    records_in(folder)
    for name in ("frame_model.py", "frame_coarse.py", "frame.tcl"):
        shutil.copy(CAMPAIGNS / name, folder)
    text = (CAMPAIGNS / "frame.toml").read_text(encoding="utf-8")
    for shipped, other in (('"farfield"', '"records"'), *changes):
        assert shipped in text
        text = text.replace(shipped, other)
    (folder / "frame.toml").write_text(text, encoding="utf-8")
    return folder / "frame.toml"


def test_the_features_are_those_of_the_design_and_its_scaled_record(tmp_path: Path) -> None:
    with create_run(tmp_path / "run", campaign_in(tmp_path)) as run:
        X = run.space.sobol(64, np.random.default_rng(1))
        features = run.features(X)
        assert features.shape == (64, 6)
        assert np.isfinite(features).all()
        assert np.array_equal(features[5:9], run.features(X[5:9]))
        # The last is the logarithm of the PGV over a capacity that does not depend on it.
        weaker, stronger = X.copy(), X.copy()
        weaker[:, -1], stronger[:, -1] = 0.6, 3.2
        assert run.space.names[-1] == "PGV"
        further = run.features(stronger)[:, -2:] - run.features(weaker)[:, -2:]
        spread = run.campaign.features.scaling[1][-2:]
        assert further * spread == pytest.approx(math.log(3.2 / 0.6))


def test_the_template_needs_no_value_of_the_level_to_which_its_record_is_scaled(tmp_path: Path) -> None:
    program = 'command = "python {here}/frame_model.py design.json {out}"'
    changes = (program, 'command = "true"\ntemplate = "frame.tcl"')
    file = campaign_in(tmp_path, changes)
    with create_run(tmp_path / "run", file) as run:
        simulator: Any = run.campaign.simulator
        assert simulator.unnamed == []


# --- with openseespy -----------------------------------------------------------------------------------------------


def test_periods_reactions_and_strength_are_those_of_other_solutions(opensees: str, tmp_path: Path) -> None:
    # A stiff, strong frame moves as a rigid mass.
    motion = design_with_record(tmp_path, 2.0)
    given = json.dumps({"design": motion, "motions": [motion]})
    command = [opensees, ROOT / "studies" / "frame_checks.py"]
    done = subprocess.run(command, input=given, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    for _, wanted, by_opensees, by_matrices in found["periods"]:
        assert by_opensees == pytest.approx(by_matrices, rel=1e-6)
        assert by_opensees == pytest.approx(wanted, rel=0.002)  # the axial stiffness stays
    assert sum(found["reactions"]) == pytest.approx(1.0, rel=1e-6)
    # A quarter of the frame's half on each inner column of three bays' tributary widths, and half of that at its ends.
    assert found["reactions"] == pytest.approx([1 / 12, 1 / 6, 1 / 6, 1 / 12, 1 / 2], abs=1e-3)
    for Cy, curve in found["pushover"].items():
        drift, shear = np.array(curve).T
        peak = shear.argmax()
        # Not all hinges yield before the first softens, and the weight takes 6/7 of the drift from the mechanism's.
        assert 0.8 < shear[peak] / float(Cy) < 1.1 - 6 / 7 * drift[peak] / float(Cy)
        assert shear[-1] < 0.1 * shear[peak]
    ((cause, _, shear, bound),) = found["motions"]
    assert cause == ""
    assert shear == pytest.approx(bound, rel=0.05)  # mu + x/L, but for the element's slope and the vertical motion


@pytest.mark.parametrize("scale", [2.0, 9.0])
def test_the_frame_in_tcl_is_the_frame_in_python(opensees: str, tmp_path: Path, scale: float) -> None:
    design = design_with_record(tmp_path, scale, storeys=2, bays=2)
    ofpython = answer_of(opensees, design, tmp_path)
    assert (ofpython["outcome"] == "collapse") == (scale == 9.0)
    text = filled_file((CAMPAIGNS / "frame.tcl").read_text(encoding="utf-8"), design)
    (tmp_path / "frame.tcl").write_text(text, encoding="utf-8")
    command = [opensees, Path(__file__).with_name("by_tcl.py"), tmp_path / "frame.tcl"]
    environment = os.environ | {"AF_OUT": str(tmp_path / "tcl.json")}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if "No module named 'tkinter'" in done.stderr or "No module named '_tkinter'" in done.stderr:
        pytest.skip("the interpreter of openseespy has no Tcl")
    assert done.returncode == 0, done.stderr
    by_tcl = json.loads((tmp_path / "tcl.json").read_text())
    assert (by_tcl["outcome"], by_tcl["cause"]) == (ofpython["outcome"], ofpython["cause"])
    assert by_tcl["margins"] == pytest.approx(ofpython["margins"], rel=1e-6)


AS_FUNCTION = """
import json, sys
from types import SimpleNamespace
import numpy as np
import frame_model
design = json.load(sys.stdin)
motion = SimpleNamespace(acceleration=np.loadtxt(design["record"]), dt=design.pop("record_dt"))
print(json.dumps(frame_model.run(design | {"record": SimpleNamespace(motion=motion)})))
"""


def test_the_function_answers_as_the_program(opensees: str, tmp_path: Path) -> None:
    design = design_with_record(tmp_path, 3.0, storeys=1, bays=1)
    command = [opensees, "-c", AS_FUNCTION]
    done = subprocess.run(command, input=json.dumps(design), capture_output=True, text=True, check=False, cwd=CAMPAIGNS)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == answer_of(opensees, design, tmp_path)


def test_a_frame_that_cannot_be_built_is_refused(opensees: str, tmp_path: Path) -> None:
    (tmp_path / "design.json").write_text(json.dumps(design_with_record(tmp_path, 3.0, bays=2.5)))
    command = [opensees, CAMPAIGNS / "frame_model.py", tmp_path / "design.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "frame_model.py: bays must be a whole number from 1 to 8, got 2.5." in done.stderr


def test_a_campaign_runs_and_answers_a_question_under_all_records(opensees: str, tmp_path: Path) -> None:
    file = campaign_in(
        tmp_path,
        ('"python {here}', f'"{opensees} {{here}}'),
        ("initial = 40", "initial = 8"),
        ("budget = 60", "budget = 10"),
        ("batch = 5", "batch = 2"),
    )
    answer = activefail("run", file, "--out", tmp_path / "run")
    assert answer.code == 0, answer.err
    with create_run(tmp_path / "run", file, exist_ok=True) as run:
        assert run.counts["numerical_failure"] == 0
        assert min(run.counts["safe"], run.counts["collapse"]) > 0
        found = run.probability(fixed=DESIGN | {"D_tot": 0.45, "PGV": 1.2}, wrong=0.0)
        assert found.stripe.known.all()
        again = run.campaign.simulator.run(found.stripe.values.X)
        assert len(again.outcome) == 3
        assert found.stripe.probability == pytest.approx(np.mean(again.outcome == 1))
