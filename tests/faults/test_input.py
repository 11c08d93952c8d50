"""User errors: each is refused, naming file, key or row and column, rule and value, with exit code 2."""

import json
import keyword
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import tomli_w
from commandline import activefail, refused
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from activefail.campaign.settings import CampaignSettings
from activefail.seismic.bearing import TABLE_1
from activefail.space.expressions import FUNCTIONS, parsed_name
from activefail.space.parameter import LARGEST
from activefail.visible import visible

Survived = Callable[[], None]

HEADER = ",".join(TABLE_1.names)
ROW = ("4.0", "0.06", "0.6", "0.8", "0.1", "50", "2e9", "2.0", "0.4")

often = hypothesis.settings(
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.filter_too_much],
)


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a campaign is already, so that one whose settings are good is not begun either."""
    folder = tmp_path_factory.mktemp("input") / "taken"
    folder.mkdir()
    (folder / "campaign.toml").write_text("")
    (folder.parent / "own_features.py").write_text("def own(X, space):\n    return X\n")
    (folder.parent / "own_model.py").write_text("def run(design):\n    return 'safe'\n")
    return folder


# --- campaign files ----------------------------------------------------------------------------------------------


def keys(values: dict[str, Any], path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """The path of every key, tables included."""
    paths = []
    for name, value in values.items():
        paths.append((*path, name))
        if isinstance(value, dict):
            paths += keys(value, (*path, name))
    return paths


def full(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings with the defaults written out."""
    return CampaignSettings.model_validate(settings).model_dump(mode="json", exclude_none=True, by_alias=True)


_OWN = {
    "space": {
        "drift": {"low": 0.5, "high": 4.0, "unit": "m"},
        "T": {"low": 1.0, "high": 3.0, "distribution": "log_uniform"},
        "mu": {"low": 0.0, "high": 0.2, "distribution": "truncated_normal", "mean": 0.1, "sd": 0.05},
        "storeys": {"value": 3.0, "unit": "-"},
    },
    "classifier": {"features": {"expressions": {"ratio": "drift / (T * storeys)", "loss": "exp(-mu)"}}},
    "stop": {"error": 0.05},
}
_ANSWERS = {"outcomes": ["safe", "damage", "failure"], "margins": ["gap", "tilt"], "time_limit": 60.0}

GOODS = (
    full({"stop": {"error": 0.05}, "classifier": {"features": {"python": "own_features:own"}}}),
    full(_OWN | {"simulator": {"python": "own_model:run"} | _ANSWERS}),
    full(_OWN | {"simulator": {"command": "model {here} {drift:.3f} {T} {mu} {storeys} {out}"} | _ANSWERS}),
)
"""Settings of a bearing, of a custom function and of a custom program."""

texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0\x7f"), max_size=12)
scalars = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.just(10**400),
    st.floats(),
    texts,
    st.sampled_from(
        ["", "entropy", "paper", "inf", "1e-3", "../mine:f", "os:system", "10s", "model {z} {out}", "a - 1"]
    ),
    st.dates(),
)
values = st.one_of(
    scalars,
    st.lists(scalars, max_size=3),
    st.dictionaries(st.text("ab.é \n", min_size=1, max_size=3), scalars, max_size=3),
)


def dotted(path: tuple[str, ...]) -> str:
    """The path of a key as TOML writes it, what is no letter shown as an escape."""
    return visible(
        ".".join(
            name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False) for name in path
        )
    )


def changed(good: dict[str, Any], path: tuple[str, ...], value: object) -> dict[str, Any]:
    """Good settings but for one value."""
    settings: dict[str, Any] = json.loads(json.dumps(good))
    section = settings
    for name in path[:-1]:
        section = section[name]
    section[path[-1]] = value
    return settings


@often
@given(place=st.sampled_from([(good, path) for good in GOODS for path in keys(good)]), value=values)
def test_a_value_that_a_key_cannot_have_is_refused_by_file_key_rule_and_value(
    place: tuple[dict[str, Any], tuple[str, ...]], value: object, taken: Path, survived: Survived
) -> None:
    good, path = place
    file = taken.with_name("mine.toml")
    file.write_text(tomli_w.dumps(changed(good, path, value)), encoding="utf-8")
    result = activefail("run", file, "--out", taken)
    refused(result)
    survived()
    if "already holds a campaign" in result.err:
        return  # the value is good
    assert result.err.startswith(f"activefail: {file}:"), result.err
    for rule in result.err.splitlines()[1:] or [result.err]:
        key = rule.removeprefix(f"activefail: {file}:").strip().partition(":")[0]
        # The key, one within the value that was given, or the table whose values do not fit each other or the key.
        # An expression may have no usable value for what the space says.
        of_expression = key == "classifier.features" and path[0] == "space" and "over the space" in rule
        assert dotted(path).startswith(key) or key.startswith(dotted(path)) or dotted(path) in rule or of_expression, (
            rule
        )
        assert re.search(
            r"got |; in |unknown key|at least 1|must be an identifier|lacks|no such|there is no|cannot|needs|require",
            rule,
        ), rule


@often
@given(
    place=st.sampled_from([(good, path) for good in GOODS for path in [(), *keys(good)]]),
    name=texts.filter(lambda text: text not in ("python", "command", "expressions", "value")),
    value=scalars,
)
def test_a_key_that_there_is_not_is_refused_by_file_and_key(
    place: tuple[dict[str, Any], tuple[str, ...]], name: str, value: object, taken: Path, survived: Survived
) -> None:
    good, path = place
    section: Any = good
    for part in path:
        section = section[part]
    # Where any name is one of the user's.
    if not isinstance(section, dict) or name in section or path[-1:] in [("space",), ("expressions",), ("levels",)]:
        hypothesis.reject()
    settings = changed(good, (*path, name), value)
    file = taken.with_name("mine.toml")
    file.write_text(tomli_w.dumps(settings), encoding="utf-8")
    refused(activefail("run", file, "--out", taken), f"{file}:\n", f"{dotted((*path, name))}: unknown key")
    survived()


names = st.from_regex(r"[a-zA-Zµα_][a-zA-Z0-9_é]{0,5}", fullmatch=True).filter(
    lambda name: (
        not keyword.iskeyword(name)
        and name not in (*FUNCTIONS, "id", "iteration", "origin", "outcome", "cause", "seconds", "out", "here")
        and name != "numerical_failure"
    )
)
"""Of variables, outcomes, margins and features."""


@st.composite
def variables(draw: st.DrawFn) -> dict[str, Any]:
    """A range with any distribution that it can have."""
    low = draw(st.floats(0.01, 10.0))
    high = low * draw(st.floats(1.5, 100.0))
    given: dict[str, Any] = {"low": low, "high": high}
    match draw(st.sampled_from([None, "uniform", "log_uniform", "truncated_normal"])):
        case None:
            pass
        case "truncated_normal":
            mean = draw(st.floats(low, high))
            given |= {"distribution": "truncated_normal", "mean": mean, "sd": (high - low) * draw(st.floats(0.1, 2.0))}
        case distribution:
            given["distribution"] = distribution
    return given | draw(st.sampled_from([{}, {"unit": "m/s²"}]))


@st.composite
def own_campaigns(draw: st.DrawFn) -> dict[str, Any]:
    """Valid settings of a campaign on a custom function or program."""
    known = draw(st.lists(names, min_size=1, max_size=8, unique_by=parsed_name))
    number = draw(st.integers(1, len(known)))
    space: dict[str, Any] = {name: draw(variables()) for name in known[:number]}
    space |= {name: {"value": draw(st.floats(-1e3, 1e3))} for name in known[number:]}
    outcomes = draw(st.lists(names, min_size=2, max_size=3, unique=True))
    simulator: dict[str, Any] = {"outcomes": outcomes}
    optional = {
        "margins": st.lists(names.filter(lambda name: name not in known), max_size=3, unique=True),
        "time_limit": st.floats(1e-3, 1e9) | st.integers(1, 10**9),
    }
    if draw(st.booleans()):
        simulator["python"] = "own_model:run"
    else:
        simulator["command"] = " ".join(["model", *(f"{{{name}}}" for name in known), "{here}/x", "{out}"])
        optional |= {"retries": st.integers(0, 100), "keep": st.booleans()}
    simulator |= draw(st.fixed_dictionaries({}, optional=optional))
    settings: dict[str, Any] = {"simulator": simulator, "space": space}
    beyond = st.sampled_from(outcomes[1:])
    settings["acquisition"] = {"boundary": draw(beyond | st.dictionaries(beyond, st.floats(0.1, 10.0), min_size=1))}
    if draw(st.booleans()):
        rule = {"error": st.floats(1e-3, 0.49)}
        extra = {
            "confidence": st.floats(0.5, 0.99),
            "simulations": st.integers(10, 10_000),
            "every": st.integers(1, 1000),
        }
        settings["stop"] = draw(st.fixed_dictionaries(rule, optional=extra))
    if draw(st.booleans()):
        seen = draw(st.lists(names.filter(lambda name: name not in known), min_size=1, max_size=3, unique=True))
        form = st.sampled_from(["{} * 2 + pi", "sqrt({})", "-{} / (1 + exp(-g))", "maximum({}, 0.001) ** 2", "log({})"])
        features = {name: draw(form).format(draw(st.sampled_from(known[:number]))) for name in seen}
        settings["classifier"] = {"features": {"expressions": features, "variables": draw(st.booleans())}}
    return settings


@often
@given(settings=own_campaigns())
def test_good_settings_of_a_campaign_of_one_s_own_are_taken(
    settings: dict[str, Any], taken: Path, survived: Survived
) -> None:
    file = taken.with_name("mine.toml")
    file.write_text(tomli_w.dumps(settings), encoding="utf-8")
    refused(activefail("run", file, "--out", taken), "already holds a campaign")
    survived()


@often
@given(
    content=st.one_of(st.binary(max_size=60), st.text(max_size=60).map(lambda text: text.encode("utf-8", "replace")))
)
def test_a_file_of_any_bytes_is_read_as_settings_or_refused_by_its_name(
    content: bytes, taken: Path, survived: Survived
) -> None:
    file = taken.with_name("mine.toml")
    file.write_bytes(content)
    result = activefail("run", file, "--out", taken)
    refused(result)
    assert "already holds a campaign" in result.err or result.err.startswith(f"activefail: {file}:")
    survived()


# --- tables ------------------------------------------------------------------------------------------------------

no_numbers = st.one_of(
    st.text(st.characters(codec="utf-8", exclude_categories=["Cs"], exclude_characters='\r\n"\0'), max_size=8),
    st.sampled_from(
        ["", " ", "nan", "-NaN", "inf", "-Infinity", "1e999", "1_000", "0x10", "1,5", "4 m", "½", "--1", "1e"]
    ),
    st.floats(max_value=0.0).map(repr),
    st.floats(min_value=1.01 * LARGEST).map(repr),
).filter(lambda text: not _is_good(text))


def _is_good(text: str) -> bool:
    try:
        value = float(text.replace("_", "?"))
    except ValueError:
        return False
    return 0.0 < value <= LARGEST


def _number(text: str) -> str | None:
    """A number as messages write it; None if the text is none."""
    try:
        return f"{float(text):g}"
    except ValueError:
        return None


@often
@given(
    before=st.integers(0, 4),
    after=st.integers(0, 3),
    column=st.integers(0, 8),
    bad=no_numbers,
    blank=st.booleans(),
    order=st.permutations(range(9)),
    end=st.sampled_from(["\n", "\r\n"]),
    mark=st.booleans(),
)
def test_a_bad_cell_is_refused_by_file_row_line_column_rule_and_value_and_nothing_is_written(
    before: int,
    after: int,
    column: int,
    bad: str,
    blank: bool,
    order: list[int],
    end: str,
    mark: bool,
    tmp_path_factory: pytest.TempPathFactory,
    survived: Survived,
) -> None:
    place = tmp_path_factory.getbasetemp() / "tables"
    place.mkdir(exist_ok=True)
    row = [f'"{text}"' if "," in text else text for text in (bad if i == column else ROW[i] for i in order)]
    good = ",".join(ROW[i] for i in order)
    lines = [",".join(TABLE_1.names[i] for i in order), *[""] * blank, *[good] * before, ",".join(row), *[good] * after]
    (place / "in.csv").write_bytes((end.join(lines) + end).encode("utf-8-sig" if mark else "utf-8"))
    result = activefail("simulate", "--csv", place / "in.csv", "--out", place / "out.csv")
    name, line = TABLE_1.names[column], before + 2 + blank
    refused(result, f"{place / 'in.csv'}: row {before + 1} (line {line}), column {name}: ", "must ", "got ")
    value = result.err.rpartition("got ")[2].rstrip(".\n")
    assert value in (repr(bad.strip()) if bad.strip() else "an empty cell", _number(bad)), result.err
    assert os.listdir(place) == ["in.csv"]
    survived()


@often
@given(content=st.one_of(st.binary(max_size=80), st.text('"a,\r\n;\t1.T_b\0é', max_size=80).map(str.encode)))
def test_a_file_of_any_bytes_is_no_table_and_is_refused_by_its_name(
    content: bytes, tmp_path_factory: pytest.TempPathFactory, survived: Survived
) -> None:
    place = tmp_path_factory.getbasetemp() / "tables"
    place.mkdir(exist_ok=True)
    (place / "in.csv").write_bytes(content)
    refused(activefail("simulate", "--csv", place / "in.csv", "--out", place / "out.csv"), f"{place / 'in.csv'}")
    assert os.listdir(place) == ["in.csv"]
    survived()


def test_a_bad_cell_at_the_end_of_a_million_rows_is_refused_in_little_memory(tmp_path: Path, every_fault: bool) -> None:
    rows = 10**6 if every_fault else 10**4
    with (tmp_path / "in.csv").open("w") as file:
        file.write(f"{HEADER}\n" + f"{','.join(ROW)}\n" * (rows - 1) + f"{','.join(ROW).replace('0.06', 'rough')}\n")
    words = [sys.executable, "-m", "activefail.cli", "simulate", "--csv", "in.csv", "--out", "out.csv"]

    def limited() -> None:
        # The libraries alone take some 0.6 GB of addresses; a million rows as Python objects would take 1 GB more.
        resource.setrlimit(resource.RLIMIT_DATA, (500 * 2**20, 500 * 2**20))

    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False, preexec_fn=limited)
    assert done.returncode == 2, done.stderr
    assert f"in.csv: row {rows} (line {rows + 1}), column mu: must be a number, got 'rough'." in done.stderr
    assert os.listdir(tmp_path) == ["in.csv"]


# --- the command line --------------------------------------------------------------------------------------------

OPTIONS = {
    "run": ["--out", "--seed", "--budget", "--workers", "--executor", "--scheduler"],
    "resume": ["--budget", "--workers", "--numerical-failures", "--code", "--executor", "--scheduler"],
    "compare": ["--budgets", "--seeds", "--test", "--static", "--code"],
    "verify": ["--simulations", "--confidence", "--code"],
    "predict": ["--csv", "--out", "--code"],
    "export": ["--csv", "--code"],
    "report": ["--out", "--code"],
    "status": [],
    "paper": ["--draws", "--fresh", "--seed"],
}


@often
@given(command=st.sampled_from(sorted(OPTIONS)), data=st.data())
def test_no_options_of_any_command_bring_a_traceback(
    command: str, data: st.DataObject, taken: Path, monkeypatch: pytest.MonkeyPatch, survived: Survived
) -> None:
    monkeypatch.chdir(taken)
    values = st.one_of(
        st.integers(-5, 5).map(str),
        texts.filter(lambda text: "\0" not in text),
        st.sampled_from(["nan", "1e9", "-", "", ".", "..", "campaign.toml", "local", "dask", "tcp://127.0.0.1:1"]),
    )
    chosen = data.draw(st.lists(st.sampled_from(OPTIONS[command]), unique=True, max_size=3)) if OPTIONS[command] else []
    # Where there is no campaign, and nothing is begun.
    words = [command, *([] if command == "paper" else ["nowhere"])]
    for option in chosen:
        words += [option, data.draw(values)]
    if command == "paper":
        words += ["--draws", "0"]
    result = activefail(*words)
    assert result.code == 2, result
    assert "Traceback" not in result.err + result.out
    assert sorted(os.listdir(taken)) == ["campaign.toml"]
    survived()
