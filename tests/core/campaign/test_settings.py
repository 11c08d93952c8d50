"""Settings: the campaign runs what they state, and every mistake is named with file, key path, rule and value."""

import math
import os
import tomllib
from pathlib import Path
from typing import Any, get_args

import hypothesis
import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import read_campaign
from activefail.campaign.settings import NAMED, CampaignSettings, parse_settings, read_settings
from activefail.errors import InputError
from activefail.learning.names import Criterion
from activefail.simulators.user_code import digest_without_running
from activefail.text.toml import read_toml


def completed(text: str) -> str:
    """A campaign file with this text, and a simulator and a variable where it states none."""
    simulator = 'simulator = { elsewhere = true, outcomes = ["no_impact", "impact", "failure"] }\n'
    space = "space.mu = { low = 0.1, high = 0.2 }\n"
    return ("" if "simulator" in text else simulator) + ("" if "space" in text else space) + text


def _refusal(text: str) -> str:
    with pytest.raises(InputError) as refused:
        parse_settings(text if text == NO_SPACE else completed(text), "mine.toml")
    return str(refused.value)


NO_SPACE = 'simulator.python = "a:b"'


def test_a_file_without_an_end_is_refused() -> None:
    with pytest.raises(InputError, match="/dev/zero: cannot be read: it is not a regular file"):
        read_settings(Path("/dev/zero"))


@pytest.mark.parametrize(
    ("rho", "features"), [(0.89, "design"), (0.9, "decorrelated"), (-0.95, "decorrelated"), ("0.95", None)]
)
def test_strongly_correlated_variables_of_a_custom_simulator_are_decorrelated(rho: object, features: str) -> None:
    values = {
        "simulator": {"python": "a:b", "outcomes": ["safe", "failure"]},
        "space": {name: {"distribution": "normal", "mean": 0.0, "sd": 1.0} for name in ("x", "y")},
        "correlation": [["x", "y", rho]],
    }
    if features is None:
        with pytest.raises(ValueError, match="correlation"):
            CampaignSettings.model_validate(values)
    else:
        assert CampaignSettings.model_validate(values).classifier.features == features


# Settings that break a rule, and what the message must contain: key path, rule and value.
BROKEN = [
    ("sead = 1", "sead: unknown key; did you mean 'seed'?"),
    (
        'simulator = { command = "a {out}", retry = 1 }\nspace.x = { low = 0, high = 1 }',
        "simulator.retry: unknown key; did you mean 'retries'?",
    ),
    (
        "space.mu = {low = 0.1, high = 0.2, mean = 0.15, sd = 0.1}",
        "space.mu: a uniform distribution takes only `low` and `high`; got `mean = 0.15` and `sd = 0.1`",
    ),
    (
        "space.mu = {low = 0.1, high = 0.2, mean = 0.15, distribution = 'truncated_normal'}",
        "space.mu: a truncated normal distribution requires `mean` and `sd`, or `mean` and `cov`; got `mean = 0.15`",
    ),
    (
        "space.mu = {low = 0.1, high = 0.2, mean = 9.0, sd = 0.1, distribution = 'truncated_normal'}",
        "space.mu: 0.1 to 0.2 must contain at least 1e-06 of the truncated normal distribution, got 0",
    ),
    (
        "space.mu = {low = 0.0, high = 0.2, distribution = 'log_uniform'}",
        "space.mu: `low > 0` must hold for a log-uniform distribution",
    ),
    (
        "space.mu = {low = 0.1, high = 0.2, distribution = 'poisson'}",
        "space.mu.distribution: must be 'uniform', 'log_uniform', 'truncated_normal'",
    ),
    (
        "space.mu = {value = 0.1, low = 0.2}",
        "space.mu.low: a variable has `low` and `high`, `choices`, `set` or `value`",
    ),
    (
        'simulator = { python = "a:b", retries = -1 }\nspace.x = { low = 0, high = 1 }',
        "simulator.retries: belongs to `command`; cannot be combined with `python`",
    ),
    (
        'simulator = { python = "a:b", command = "a {out}" }\nspace.x = { low = 0, high = 1 }',
        "simulator.command: cannot be combined with `python`",
    ),
    (
        'classifier.features = { python = "a:b", expressions = { x = "mu" } }',
        "classifier.features.expressions: cannot be combined with `python`",
    ),
    (
        'simulator = { tcl = "model.tcl" }',
        f"simulator: must be {'a name, ' if NAMED else ''}a table with `python` or a table with `command`",
    ),
    ('simulator.python = "model.py"', 'simulator.python: must be "module:function"'),
    (
        'simulator = { python = "a:b", outcomes = ["failure", "safe"] }',
        "simulator.outcomes: the least severe outcome must come first, but 'safe' is the last of ['failure', 'safe']",
    ),
    ('[space]\nx = { low = 1, high = 2, "a range" = 3 }\n', 'space.x."a range": unknown key'),
    (
        'simulator = { python = "a:b", margins = ["g", "h"], system = "min(g, i)" }',
        "simulator.system: must name margins among g, h, got 'i' in 'min(g, i)'",
    ),
    (
        'simulator = { python = "a:b", margins = ["g", "h"], system = "g + h" }',
        "simulator.system: must be min(...) or max(...) of two margins or more, which may be nested, got 'g + h'",
    ),
    (
        'simulator = { python = "a:b", margins = ["g", "h"], system = "min(g)" }',
        "simulator.system: must be min(...) or max(...) of two margins or more, which may be nested, got 'min(g)'",
    ),
    (
        'simulator = { python = "a:b", margins = ["g", "h"], system = "g" }',
        "simulator.system: must be min(...) or max(...) of two margins or more, which may be nested, got 'g'",
    ),
    (
        'simulator = { python = "a:b", margins = ["g", "h", "i"], system = "max(g, h)" }',
        "simulator.system: must contain every margin, but 'i' is not in 'max(g, h)'",
    ),
    (
        'simulator = { python = "a:b", margins = ["g", "h"], system = "min(g, h)", outcomes = ["a", "b", "c"] }',
        "simulator.system: requires two outcomes",
    ),
    (
        'simulator = { python = "a:b", margins = ["g", "h"], system = "min(g, h)", levels = { g = [1.0] } }',
        "simulator.system: cannot be combined with levels",
    ),
    (
        'simulator = { python = "a:b", margins = ["g", "h"], system = "min(g, h)", truncated = ["g"] }',
        "simulator.system: cannot be combined with truncated",
    ),
    (
        'simulator = { python = "a:b", margins = ["g", "h"], system = "min(g, h)", repeatable = false }',
        "simulator.repeatable: must be true with simulator.system",
    ),
    (
        'simulator = { python = "a:b", margins = ["g"], levels = { h = [0.1] } }',
        "simulator.levels: must name one of simulator.margins (g), got 'h'",
    ),
    (
        'simulator = { python = "a:b", margins = ["g"], levels = { g = [0.1, 0.0] } }',
        "simulator.levels: g: must have a level for each of failure, got [0.1, 0.0]",
    ),
    (
        'simulator = { python = "a:b", outcomes = ["a", "b", "c"], margins = ["g"], levels = { g = [0.1, 0.1] } }',
        "simulator.levels: g: must decrease from outcome to outcome, got [0.1, 0.1]",
    ),
    (
        'simulator = { python = "a:b", margins = ["g"], levels = { g = [nan] } }',
        "simulator.levels.g.0: must be a finite number, got nan",
    ),
    (
        'simulator = { command = "a", pattern = "x (", margins = ["g"] }',
        "simulator.pattern: must be a regular expression",
    ),
    ('simulator = { command = "a", pattern = "x", margins = ["g"] }', "simulator.pattern: must have one group"),
    (
        'simulator = { command = "a", pattern = "(x)" }',
        "simulator: pattern: requires one margin, and two outcomes or stated levels",
    ),
    ('simulator = { python = "a:b", margins = "g" }', "simulator.margins: must be a valid list, got 'g'"),
    ('simulator = { python = "a:b", margins = { g = 1 } }', "simulator.margins.g: must be a valid string, got 1"),
    (
        'simulator = { python = "a:b", margins = { g = "1 -" } }',
        "simulator.margins: g: must be an arithmetic expression, got '1 -'",
    ),
    (
        'simulator = { python = "a:b", margins = { g = "fail(u)" } }',
        "simulator.margins: g: may contain numbers, names, + - * / **",
    ),
    (
        'simulator = { python = "a:b", margins = { g = "1 - 0.5" } }',
        "simulator.margins: g: must contain an output of the simulator, got '1 - 0.5'",
    ),
    (
        'simulator = { python = "a:b", margins = { u = "1 - u" } }',
        "simulator.margins: u: must have another name than the output 'u', got '1 - u'",
    ),
    (
        'simulator = { python = "a:b", margins = { g = "1 - u" }, levels = { g = [0.1] } }',
        "simulator.levels: g: cannot be combined with its expression '1 - u', which is at most 0 at failure; got [0.1]",
    ),
    (
        'simulator = { python = "a:b", margins = { g = "1 - u" }, system = "min(g, u)" }',
        "simulator.system: must name margins among g, got 'u'",
    ),
    (
        'simulator = { command = "a", margins = { g = "1 - u - v" }, pattern = "(.)" }',
        "simulator: pattern: must be a table with a pattern for each of u, v",
    ),
    (
        'simulator = { command = "a", margins = { g = "1 - u - v" }, pattern = { u = "(.)", w = "(.)" } }',
        "simulator: pattern: must name the outputs in simulator.margins (u, v), got u, w",
    ),
    (
        'simulator = { command = "a", margins = ["g"], pattern = { g = "(.)" } }',
        "simulator: pattern: must name the outputs in simulator.margins (none), got g",
    ),
    (
        'simulator = { command = "a", margins = { g = "1 - u - v" }, pattern = { u = "(.)", v = "." } }',
        "simulator.pattern: must have one group in brackets, for the number, got '.'",
    ),
    ('simulator = { python = "a:b", copy = "x" }', "simulator.copy: belongs to `command`"),
    ('simulator = { command = "a {out}", time_limit = 0.0 }', "simulator.time_limit: must be greater than 0"),
    ('seed = "one"', "seed: must be"),
    ("space.mu = {low = 0.1}", "space.mu: a uniform distribution requires `low` and `high`"),
    (
        'simulator = { python = "a:b", outcomes = ["a", "b", "c", "d"] }',
        "simulator.outcomes: must have at most 3 entries, got ['a', 'b', 'c', 'd']",
    ),
    ("space.mu = [0.1, 0.2]", "space.mu: must be a table of keys and values, got [0.1, 0.2]"),
    ("stop = 0.05", "stop: must be a table with `error` or a table with "),
    (NO_SPACE, "space: required with a custom simulator"),
    ("sampling = {initial = 100, budget = 50}", "sampling: `initial <= budget` must hold, got initial = 100 and"),
    ("space.mu = {low = 0.2, high = 0.1}", "space.mu: `low < high` must hold, got 0.2 and 0.1"),
    ("space.mu = {low = 1, high = 1e155}", "space.mu: the range must lie between -1e+75 and 1e+75, got 1 to 1e+155"),
    ("acquisition.boundary = 2", "acquisition.boundary: must be a table of keys and values, got 2"),
    ("acquisition.boundary = {}", "acquisition.boundary: must have at least 1 entry"),
    (
        "acquisition.boundary = {failure = 1, impact = 0}",
        "acquisition.boundary.impact: must be greater than 0, got 0",
    ),
    (f"seed = 0x{'f' * 6000}", "seed: must be less than 9223372036854775808, got a number with thousands of digits"),
    ('space."T b" = {low = 1, high = 2}', "space: a variable's name must be an identifier, got 'T b'"),
]


@pytest.mark.parametrize(("text", "says"), BROKEN, ids=[says[:40] for _, says in BROKEN])
def test_a_broken_rule_is_named_with_file_key_path_rule_and_value(text: str, says: str) -> None:
    message = _refusal(text)
    assert message.startswith(f"mine.toml:\n  {says}")
    assert len(message.splitlines()) == 2
    assert len(message) < 400


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ('seed = "7"', "seed"),
        ('space.mu = { low = "0.1", high = 0.2 }', "space.mu.low"),
        ("sampling.asynchronous = 0", "sampling.asynchronous"),
    ],
)
def test_a_value_of_another_type_is_refused_and_not_taken_for_what_it_might_mean(text: str, key: str) -> None:
    assert f"{key}: must be" in _refusal(text)


def test_a_whole_number_will_do_where_any_number_will() -> None:
    assert parse_settings(completed("space.mu = { low = 0, high = 1 }"), "mine.toml").space["mu"].high == 1.0


def test_all_mistakes_are_named_at_once() -> None:
    lines = _refusal('seed = -1\nsampling.batch = 0\nclassifier.kernel = "linear"\nextra = 1').splitlines()
    assert [line.strip().split(":")[0] for line in lines] == [
        "mine.toml",
        "seed",
        "sampling.batch",
        "classifier.kernel",
        "extra",
    ]


def test_a_file_that_is_not_utf8_is_refused_naming_file_and_place(tmp_path: Path) -> None:
    path = tmp_path / "latin.toml"
    path.write_bytes('description = "Lager für Brücken"'.encode("latin-1"))
    with pytest.raises(InputError, match=r"latin\.toml: not UTF-8 text: .* at byte 22"):
        read_settings(path)


def test_weights_of_boundaries_are_shares_and_the_largest_is_the_main_one() -> None:
    acquisition = parse_settings(completed("acquisition.boundary = {impact = 1, failure = 3}"), "mine.toml").acquisition
    assert acquisition.boundaries == {"impact": 0.25, "failure": 0.75}
    assert acquisition.main_boundary == "failure"
    one = parse_settings(completed('acquisition.boundary = "impact"'), "mine.toml").acquisition
    assert (one.boundaries, one.main_boundary) == ({"impact": 1.0}, "impact")
    equal = parse_settings(
        completed("acquisition.boundary = {impact = 1e308, failure = 1e308}"), "mine.toml"
    ).acquisition
    assert (equal.boundaries, equal.main_boundary) == ({"impact": 0.5, "failure": 0.5}, "impact")


@pytest.mark.parametrize(
    ("outcomes", "acquisition", "boundary"),
    [
        ('outcomes = ["ok", "broken"]', "", "broken"),
        ('outcomes = ["ok", "cracked", "broken"]', 'criterion = "bald"', "broken"),
        ('outcomes = ["ok", "cracked", "broken"]', 'boundary = "cracked"', "cracked"),
        ("", "", "failure"),
    ],
)
def test_the_boundary_of_a_simulator_of_ones_own_is_that_of_its_most_severe_outcome_where_none_is_named(
    outcomes: str, acquisition: str, boundary: str
) -> None:
    simulator = f'[simulator]\ncommand = "a {{out}}"\n{outcomes}\n'
    text = f"{simulator}[space]\nx = {{ low = 0, high = 1 }}\n[acquisition]\n{acquisition}"
    settings = parse_settings(text, "mine.toml")
    assert settings.acquisition.boundaries == {boundary: 1.0}
    assert Campaign.of(settings).severity == len(settings.simulator.outcomes) - 1 - (boundary == "cracked")
    assert parse_settings(settings.text(), "frozen") == settings


@pytest.mark.parametrize(
    "name",
    ["ok", "passed", "no_failure", "not_failed", "intact", "none", "without_damage", "_safe_"],
)
def test_a_word_for_safety_is_not_the_most_severe_outcome(name: str) -> None:
    text = f'simulator = {{ python = "a:b", outcomes = ["other", "{name}"] }}\nspace.x = {{ low = 0, high = 1 }}'
    assert f"simulator.outcomes: the least severe outcome must come first, but {name!r} is the last" in _refusal(text)


@pytest.mark.parametrize(
    "name",
    ["unsafe", "not_ok", "not_safe", "failed_to_pass", "unstable", "not_intact", "nonlinear", "loss_of_stability"],
)
def test_other_names_may_be_the_most_severe_outcome(name: str) -> None:
    text = f'simulator = {{ python = "a:b", outcomes = ["safe", "{name}"] }}\nspace.x = {{ low = 0, high = 1 }}'
    assert parse_settings(text, "mine.toml").acquisition.boundary == name


finite = st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20)
sampling = st.tuples(st.integers(2, 10**6), st.integers(2, 10**6), st.integers(1, 500)).map(
    lambda t: {"initial": min(t[:2]), "budget": max(t[:2]), "batch": t[2]}
)
bound = st.floats(-1e75, 1e75)
names = st.from_regex(r"[^\W\d]\w{0,9}", fullmatch=True).filter(str.isidentifier)
variable = st.tuples(bound, bound, texts).filter(lambda t: t[0] < t[1])
valid = st.fixed_dictionaries(
    {
        "simulator": st.just({"python": "a:b", "outcomes": ["safe", "failure"]}),
        "space": st.dictionaries(
            names, variable.map(lambda t: dict(zip(("low", "high", "unit"), t, strict=True))), min_size=1, max_size=4
        ),
    },
    optional={
        "description": texts,
        "seed": st.integers(0, 2**63 - 1),
        "sampling": sampling,
        "classifier": st.fixed_dictionaries({"kernel": st.sampled_from(["rbf", "matern52"])}),
        "acquisition": st.fixed_dictionaries(
            {},
            optional={
                "criterion": st.sampled_from(get_args(Criterion)),
                "boundary": texts | st.dictionaries(texts, finite.filter(lambda w: w > 0.0), min_size=1, max_size=3),
                "exploration": st.floats(0.0, 1.0),
            },
        ),
        "limits": st.fixed_dictionaries({"numerical_failures": st.floats(0.0, 1.0)}),
        "validation": st.fixed_dictionaries({"size": st.integers(0, 10**5)}),
    },
)


@hypothesis.settings(deadline=None)
@given(values=valid)
def test_settings_written_out_and_read_again_are_the_same_to_the_last_bit(values: dict[str, Any]) -> None:
    stay_the_same(values)


def stay_the_same(values: dict[str, Any]) -> None:
    """Assert that settings are the same to the last bit when they are written out and read again."""
    settings = parse_settings(tomli_w.dumps(values), "drawn")
    text = settings.text()
    repeated = parse_settings(text, "written out")
    assert repeated == settings
    # Equal floats are not yet equal bits: zero has two signs.
    assert repeated.text() == text
    assert list(repeated.space) == list(settings.space)


@pytest.mark.parametrize(
    "features", ['"decorrelated"', '{ python = "mine.physics:f" }', '{ python = "m:f", variables = false }']
)
def test_the_frozen_copy_says_what_the_classifier_sees(features: str) -> None:
    settings = parse_settings(completed(f"classifier.features = {features}"), "mine.toml")
    assert parse_settings(settings.text(), "frozen") == settings


OWN = """
import numpy as np

def ratio(X, space):
    T_b, T_p = space.pick(X.T, ["T_b", "T_p"])
    return np.log(T_b / T_p)[:, None]
"""
PERIODS = "space.T_b = { low = 2.5, high = 5.5 }\nspace.T_p = { low = 0.25, high = 5.0 }\n"


def test_a_function_beside_the_campaigns_file_says_what_the_classifier_sees(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    text = 'classifier.features = { python = "mine:ratio", variables = false }\n'
    (tmp_path / "mine.toml").write_text(completed(text + PERIODS))
    campaign = read_campaign(tmp_path / "mine.toml", code=tmp_path)
    assert campaign.features.names == ("ratio[0]",)
    X = campaign.space.latin_hypercube(4, np.random.default_rng(0))
    assert campaign.features.raw(X).tolist() == np.log(X[:, [0]] / X[:, [1]]).tolist()
    assert campaign.sources == {"classifier.features.python": digest_without_running("mine:ratio", tmp_path)}


@pytest.mark.parametrize(
    ("source", "says"),
    [
        (None, r"there is no module 'mine'; looked for .*/mine\.py"),
        ("def other(X, space): pass", r".*/mine\.py has no function 'ratio'"),
        ("1 / 0", "mine cannot be imported: ZeroDivisionError: division by zero"),
    ],
)
def test_a_function_that_cannot_be_loaded_is_refused_by_file_key_and_reason(
    tmp_path: Path, source: str | None, says: str
) -> None:
    if source is not None:
        (tmp_path / "mine.py").write_text(source)
    path = tmp_path / "mine.toml"
    path.write_text(completed('classifier.features = { python = "mine:ratio" }\n' + PERIODS))
    with pytest.raises(InputError, match=rf"mine\.toml: classifier\.features\.python: {says}"):
        read_campaign(path, code=tmp_path)


def test_a_changed_function_is_told_on_resume(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    path = tmp_path / "mine.toml"
    path.write_text(completed('classifier.features = { python = "mine:ratio" }\n' + PERIODS))
    before = read_campaign(path, code=tmp_path).sources
    (tmp_path / "mine.py").write_text(OWN + "changed = True")
    assert read_campaign(path, code=tmp_path).sources.keys() == before.keys()
    assert read_campaign(path, code=tmp_path).sources != before


def test_half_of_a_small_budget_is_the_initial_design_unless_a_file_says_more() -> None:
    def initial(text: str) -> int:
        return parse_settings(completed(text), "mine.toml").sampling.initial

    assert [initial(f"sampling.budget = {n}") for n in (2, 3, 40, 249, 250, 1000)] == [2, 2, 20, 124, 250, 250]
    assert initial("sampling = { initial = 30, budget = 40 }") == 30


def test_the_frozen_copy_writes_the_defaults_out() -> None:
    def keys(model: Any) -> Any:
        return {name: keys(value) if isinstance(value, dict) else None for name, value in model.items()}

    written = tomllib.loads(parse_settings(completed("seed = 1"), "mine.toml").text())
    assert keys(written) == keys(parse_settings(completed(""), "mine.toml").model_dump(exclude_none=True))


@hypothesis.settings(deadline=None)
@given(
    key=st.sampled_from(["sampling.initial", "sampling.budget", "sampling.batch", "validation.size", "seed"]),
    value=st.one_of(st.integers(-(2**62), -1), finite.filter(lambda x: not x.is_integer()), st.just(math.nan)),
)
def test_no_count_is_negative_fractional_or_nan(key: str, value: float) -> None:
    assert f"  {key}: must be" in _refusal(tomli_w.dumps(_nested(key, value)))


def _nested(key: str, value: Any) -> dict[str, Any]:
    head, _, tail = key.partition(".")
    return {head: {tail: value} if tail else value}


def test_the_command_lines_seed_and_budget_replace_the_files_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(completed("seed = 1\nsampling.batch = 7"))
    changed = read_settings(file, seed=5, budget=600)
    assert (changed.seed, changed.sampling.budget, changed.sampling.batch) == (5, 600, 7)
    assert read_settings(file, seed=1, budget=500) == read_settings(file)


@pytest.mark.parametrize(
    ("stated", "initial"),
    [("", (20, 4, 2)), ("sampling.budget = 300", (20, 4, 2)), ("stop.probability = 'failure'", (12, 4, 2))],
)
def test_the_default_initial_design_follows_the_command_lines_budget(
    stated: str, initial: tuple[int, ...], tmp_path: Path
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f"simulator.command = 'a {{out}}'\nspace.x = {{low = 0.0, high = 1.0}}\n{stated}")
    assert tuple(read_settings(file, budget=n).sampling.initial for n in (40, 8, 3)) == initial


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('acquisition.boundary = "collapse"', "acquisition.boundary: must be one of impact, failure, got 'collapse'"),
        (
            "acquisition.boundary = {failure = 1, collapse = 1}",
            "acquisition.boundary: must be one of impact, failure, got 'collapse'",
        ),
        *(
            (
                f"simulator.command = 'a {{out}}'\nspace.{name} = {{low = 0.1, high = 0.2}}",
                f"space.{name}: {name!r} is already the name of a column that `activefail predict` adds; rename it.",
            )
            for name in ("likeliest_outcome", "p_safe", "p_failure", "latent_mean", "latent_sd")
        ),
        *(
            (
                f"simulator = {{ command = 'a {{out}}', margins = ['g'] }}\nspace.x = {{low = 0.1, high = 0.2}}\n"
                f"space.{name} = {{value = 1.0}}",
                f"{key}: {name!r} is already the name of {meaning}; rename it.",
            )
            for name, key, meaning in (
                ("id", "space.id", "a column of tables of simulations"),
                ("seconds", "space.seconds", "a column of tables of simulations"),
                ("outcome", "space.outcome", "a column of tables of simulations"),
                ("cause", "space.cause", "a column of tables of simulations"),
                ("former_g", "space.former_g", "a column of tables of simulations"),
                ("p_failure", "space.p_failure", "a column that `activefail predict` adds"),
                ("g", "simulator.margins", "the quantity space.g"),
            )
        ),
        (
            "simulator = { command = 'a {out}', outcomes = ['safe', 'in_flight'] }\nspace.x = {low = 0.1, high = 0.2}",
            "simulator.outcomes: 'in_flight' is already the name of a count of simulations; rename it.",
        ),
        *(
            (
                f"simulator = {{ command = 'a {{out}}', margins = ['{name}'] }}\nspace.x = {{low = 0.1, high = 0.2}}",
                f"simulator.margins: {name!r} is already the name of",
            )
            for name in ("id", "seconds", "p_safe", "x")
        ),
    ],
)
def test_pieces_that_do_not_fit_each_other_are_refused_by_key_path_rule_and_value(text: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        Campaign.of(parse_settings(completed(text), "mine.toml"))
    assert says in str(refused.value)


@pytest.mark.parametrize("text", ['x = "a\\u0000b"', '[y]\nz = [{ "a\\u0000" = 1 }]'])
def test_a_text_with_a_nul_is_refused_wherever_it_is(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError, match=r"a\.toml: a text must not contain the character U\+0000"):
        read_toml(tmp_path / "a.toml")


def test_a_pipe_is_no_file_of_settings(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.toml")
    with pytest.raises(InputError, match=r"a\.toml: cannot be read: it is not a regular file"):
        read_toml(tmp_path / "a.toml")


def test_a_message_about_a_long_key_or_value_is_bounded() -> None:
    for text in (f"{'a' * 3_000_000} = 1", f'seed = "{"a" * 3_000_000}"', f"space.{'a' * 3_000_000} = {{ low = 1 }}"):
        with pytest.raises(InputError) as refused:
            parse_settings(text, "mine.toml")
        assert len(str(refused.value)) < 30_000
