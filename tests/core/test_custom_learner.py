"""Kernels, likelihoods, models and criteria of docs/classifier.md, each in a whole campaign."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from commandline import activefail

from activefail import open_run

PAGE = Path(__file__).parents[2] / "docs" / "classifier.md"
CODE = "\n".join(re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL))
AFTER = len(CODE.splitlines()) + 1
CAMPAIGN = """
seed = 3
[sampling]
initial = 20
budget = 26
batch = 3
[simulator]
python = "limit:run"
outcomes = ["safe", "failure"]
[space]
x = {{ low = -5.0, high = 5.0 }}
y = {{ low = -5.0, high = 5.0 }}
[classifier]
features = "design"
{classifier}
[acquisition]
criterion = {criterion}
"""
LIMIT = 'def run(v):\n    return "failure" if v["x"] ** 2 / 9 + v["y"] ** 2 / 4 > 1 else "safe"\n'
CASES = {
    "kernel": ('kernel = { python = "mine:kernel" }', '"eavc"'),
    "likelihood": ('kernel = "matern52"\nlikelihood = { python = "mine:Robust" }', '"entropy"'),
    "model": ('model = { python = "mine:model" }', '"joint_entropy"'),
    "criterion": ('kernel = "matern52"', '{ python = "mine:Near" }'),
    "integrated": ('model = { python = "mine:model" }', '{ python = "mine:integrated" }'),
    "BoTorch's": ("", '{ python = "botorch.acquisition.analytic:PosteriorStandardDeviation" }'),
}


def campaign(folder: Path, case: str) -> Path:
    classifier, criterion = CASES[case]
    (folder / "mine.py").write_text(CODE)
    (folder / "limit.py").write_text(LIMIT)
    file = folder / "custom.toml"
    file.write_text(CAMPAIGN.format(classifier=classifier, criterion=criterion))
    return file


@pytest.mark.parametrize("case", CASES)
def test_custom_code_learns_and_proposes_in_a_campaign_and_continues_with_the_same_bits(
    case: str, tmp_path: Path
) -> None:
    file = campaign(tmp_path, case)
    assert activefail("run", file, "--out", tmp_path / "whole").code == 0
    # Opened again after each batch, as after a kill.
    assert activefail("run", file, "--out", tmp_path / "parts", "--budget", 20).code == 0
    for budget in (23, 26):
        assert activefail("resume", tmp_path / "parts", "--budget", budget, "--code", tmp_path).code == 0
    whole, parts = (open_run(tmp_path / name, code=tmp_path) for name in ("whole", "parts"))
    np.testing.assert_array_equal(whole.history.designs, parts.history.designs)
    X = whole.space.sobol(64, np.random.default_rng(0))
    assert parts.predict(X)["p_failure"].to_numpy() == pytest.approx(whole.predict(X)["p_failure"].to_numpy(), abs=1e-9)
    mean = whole.model("failure").posterior(torch.from_numpy(whole.features(X)).unsqueeze(1)).mean
    assert mean.detach().numpy().ravel() == pytest.approx(
        whole.classifier.latent("failure").moments(whole.features(X)).mean
    )
    assert activefail("report", tmp_path / "whole", "--code", tmp_path).code == 0


def test_a_campaign_whose_learner_changed_is_refused_until_its_folder_is_named(tmp_path: Path) -> None:
    file, run = campaign(tmp_path, "kernel"), tmp_path / "run"
    assert activefail("run", file, "--out", run, "--budget", 23).code == 0
    (tmp_path / "mine.py").write_text(CODE.replace("nu=1.5", "nu=0.5"))
    refused = activefail("resume", run)
    assert (refused.code, "custom code" in refused.err, "has changed" in refused.err) == (2, True, True)
    assert activefail("resume", run, "--code", tmp_path).code == 0


CHANGES = {
    "kernel": ("nu=1.5", "nu=0.5"),
    "likelihood": ("tensor(-4.0)", "tensor(-1.0)"),
    "model": ("=Normalize(features.shape[-1])", "=None"),
    "criterion": ("return X / 5.0", "return X**3"),
}
"""Of the code of a learner: a text, and what takes its place. With a custom criterion, the features change."""
FEATURES = "\ndef features(X, space):\n    return X / 5.0\n"


@pytest.mark.parametrize("case", CHANGES)
def test_nothing_that_former_code_has_learned_or_verified_is_used(case: str, tmp_path: Path) -> None:
    file, code, run, table = campaign(tmp_path, case), tmp_path / "mine.py", tmp_path / "run", tmp_path / "designs.csv"
    code.write_text(CODE + FEATURES)
    if case == "criterion":
        file.write_text(file.read_text().replace('"design"', '{ python = "mine:features" }'))
    table.write_text("x,y\n1.0,1.0\n3.0,0.1\n2.0,1.0\n")
    assert activefail("run", file, "--out", run, "--budget", 23).code == 0
    assert activefail("verify", run, "--simulations", 20, "--code", tmp_path).code == 0
    predicting = ["predict", run, "--csv", table, "--code", tmp_path, "--out"]
    assert "verified error" in activefail(*predicting, tmp_path / "former.csv").out
    former, latter = CHANGES[case]
    assert former in code.read_text()
    code.write_text(code.read_text().replace(former, latter))
    saved = activefail(*predicting, tmp_path / "saved.csv")
    assert "was learned with other custom code" in saved.err
    assert "verified error" not in saved.out
    (run / "checkpoint.h5").unlink()
    assert activefail(*predicting, tmp_path / "learned.csv").code == 0
    tables = [(tmp_path / f"{name}.csv").read_text() for name in ("former", "saved", "learned")]
    assert tables[0] != tables[1] == tables[2]


@pytest.mark.parametrize(
    ("case", "code", "says"),
    [
        (
            "kernel",
            "def kernel(dimension):\n    return 3\n",
            "classifier.kernel: must return a GPyTorch kernel, got int",
        ),
        ("criterion", "class Near:\n    pass\n", "acquisition.criterion.python: raised TypeError"),
        ("criterion", "def Near(model):\n    return lambda X: X[:, 0, 0].log()\n", "acquisition.criterion: must be a"),
        (
            "likelihood",
            f"{CODE}\nclass Robust(Robust):\n    def marginal(self, f):\n        return 1 / 0\n",
            f"likelihood.python: raised ZeroDivisionError: division by zero ({{folder}}/mine.py:{AFTER + 3})",
        ),
        (
            "model",
            "def model(features, labels):\n    return labels.mean()\n",
            "classifier.model: must return a BoTorch model, got Tensor",
        ),
    ],
)
def test_an_error_of_custom_code_names_its_setting_and_line_before_the_first_simulation(
    case: str, code: str, says: str, tmp_path: Path
) -> None:
    file = campaign(tmp_path, case)
    (tmp_path / "mine.py").write_text(code)
    failed = activefail("run", file, "--out", tmp_path / "run")
    assert failed.code == 2
    assert says.format(folder=tmp_path) in failed.err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("classifier", "says"),
    [
        ('model = { python = "a:b" }\nlikelihood = { python = "a:b" }', "model: cannot be combined with a custom"),
        ('kernel = { python = "a:b" }\nlearns = "g"', "learns: must be 'auto' or 'outcomes' with a custom kernel"),
        ('kernel = "cubic"', "classifier.kernel"),
    ],
)
def test_combinations_without_a_meaning_are_refused(classifier: str, says: str, tmp_path: Path) -> None:
    file = campaign(tmp_path, "kernel")
    file.write_text(CAMPAIGN.format(classifier=classifier, criterion='"entropy"'))
    refused = activefail("run", file, "--out", tmp_path / "run")
    assert (refused.code, says in refused.err) == (2, True)
