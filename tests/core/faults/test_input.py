"""User errors: each is refused, naming file, key or row and column, rule and value, with exit code 2."""

import json
import keyword
import os
import re
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
from activefail.campaign.variables import Choices, FixedVariable, SetVariable, Variable
from activefail.space.expressions import FUNCTIONS, parsed_name
from activefail.visible import visible

Survived = Callable[[], None]


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
    full(_OWN | {"simulator": {"python": "own_model:run"} | _ANSWERS}),
    full(_OWN | {"simulator": {"command": "model {here} {drift:.3f} {T} {mu} {storeys} {out}"} | _ANSWERS}),
    full(_OWN | {"simulator": {"python": "own_model:run"}, "classifier": {"features": {"python": "own_features:own"}}}),
)
"""Settings of a custom function, of a custom program, and of custom features."""

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


def is_taken_or_refused(good: dict[str, Any], path: tuple[str, ...], value: object, taken: Path) -> None:
    """Assert that good settings with another value of a key are taken, or refused by file, key, rule and value."""
    file = taken.with_name("mine.toml")
    file.write_text(tomli_w.dumps(changed(good, path, value)), encoding="utf-8")
    result = activefail("run", file, "--out", taken)
    refused(result)
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
@given(place=st.sampled_from([(good, path) for good in GOODS for path in keys(good)]), value=values)
def test_a_value_that_a_key_cannot_have_is_refused_by_file_key_rule_and_value(
    place: tuple[dict[str, Any], tuple[str, ...]], value: object, taken: Path, survived: Survived
) -> None:
    is_taken_or_refused(*place, value, taken)
    survived()


OF_VARIABLES = {key for kind in (Variable, Choices, SetVariable, FixedVariable) for key in kind.model_fields}
NO_NAMES = {"python", "command", "expressions", *OF_VARIABLES}
"""Names of keys that are known in some tables only."""


def is_unknown(good: dict[str, Any], path: tuple[str, ...], name: str, value: object, taken: Path) -> None:
    """Assert that good settings with another key are refused by file and key."""
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


@often
@given(
    place=st.sampled_from([(good, path) for good in GOODS for path in [(), *keys(good)]]),
    name=texts.filter(lambda text: text not in NO_NAMES),
    value=scalars,
)
def test_a_key_that_there_is_not_is_refused_by_file_and_key(
    place: tuple[dict[str, Any], tuple[str, ...]], name: str, value: object, taken: Path, survived: Survived
) -> None:
    is_unknown(*place, name, value, taken)
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
}


@often
@given(command=st.sampled_from(sorted(OPTIONS)), data=st.data())
def test_no_options_of_any_command_bring_a_traceback(
    command: str, data: st.DataObject, taken: Path, monkeypatch: pytest.MonkeyPatch, survived: Survived
) -> None:
    monkeypatch.chdir(taken)
    # Where there is no campaign, and nothing is begun.
    bring_no_traceback([command, "nowhere"], OPTIONS[command], data, taken)
    survived()


def bring_no_traceback(
    words: list[str], options: list[str], data: st.DataObject, taken: Path, last: tuple[str, ...] = ()
) -> None:
    """Assert that a command with some of its options, with any values, and the last words is refused."""
    values = st.one_of(
        st.integers(-5, 5).map(str),
        texts.filter(lambda text: "\0" not in text),
        st.sampled_from(["nan", "1e9", "-", "", ".", "..", "campaign.toml", "local", "dask", "tcp://127.0.0.1:1"]),
    )
    chosen = data.draw(st.lists(st.sampled_from(options), unique=True, max_size=3)) if options else []
    words = [*words, *(word for option in chosen for word in (option, data.draw(values))), *last]
    result = activefail(*words)
    assert result.code == 2, result
    assert "Traceback" not in result.err + result.out
    assert sorted(os.listdir(taken)) == ["campaign.toml"]
