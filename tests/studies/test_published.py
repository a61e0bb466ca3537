"""The table of published figures."""

import json
from fnmatch import fnmatchcase

import pytest

from tests.studies import (
    band_coverage,
    calibrate,
    controller_bounds,
    encoder_noise,
    expected,
    friction_left_out,
    outliers,
    payload,
    payload_real,
    sbc,
)
from tests.studies.page import STUDIES
from tests.studies.published import SHOWN, compared, leaves, published, stored

MADE = {
    "band-coverage": band_coverage, "calibrate-coverage": calibrate, "controller-bounds": controller_bounds,
    "encoder-noise": encoder_noise, "expected": expected, "friction-left-out": friction_left_out, "outliers": outliers,
    "payload-coverage": payload, "payload-real": payload_real, "sbc": sbc,
}  # fmt: skip
BLIND = "case_studies/blind_naming/results.json"


def test_figures_are_found_by_their_keys():
    data = {"cases": 7, "rates": {"named": [0.9, 100], "not": [0.0, 50]}, "seconds": {"median": 2.0}, "other": [1, 2]}
    found = published(BLIND, data)
    assert {name: value for name, (value, _) in found.items()} == {"rates/named": 0.9, "rates/not": 0.0, "seconds/median": 2.0}
    assert found["rates/named"][1] == pytest.approx(0.03) and found["seconds/median"][1] is None
    assert dict(leaves({"a": [{"b": 1}, {"b": True}], "c": "x"})) == {"a/0/b": 1}


def test_a_difference_is_in_standard_errors_where_it_can_be():
    old = published(BLIND, {"rates": {"named": [0.9, 100]}, "seconds": {"median": 2.0}})
    new = published(BLIND, {"rates": {"named": [0.8, 100]}, "seconds": {"median": 3.0}})
    rows = {row["name"]: row for row in compared(old, new)}
    assert rows["rates/named"]["difference"] == "-0.1 (-2.0 se)"
    assert rows["seconds/median"]["difference"] == "+1 (+50.0 %)"
    assert compared(old, old) == []
    assert compared({}, {"x": (1.0, None)}) == [{"name": "x", "old": "–", "new": "1", "difference": ""}]


@pytest.mark.parametrize("path", sorted(SHOWN))
def test_every_stored_study_has_its_figures(path):
    """A pattern that finds nothing would leave figures out unseen."""
    data = json.loads((STUDIES.parents[1] / path).read_text(encoding="utf-8"))
    for pattern in SHOWN[path]:
        assert any(_fits(name, pattern) for name in published(path, data)), pattern


def _fits(name, pattern):
    keys, parts = name.split("/"), pattern.split("/")
    return len(keys) == len(parts) and all(map(fnmatchcase, keys, parts))


def test_the_page_has_every_stored_study():
    text = (STUDIES / "figures" / "README.md").read_text(encoding="utf-8")
    assert [path for path in stored() if f"| [{path}]" not in text] == [], "run python -m tests.studies.published --write"


@pytest.mark.parametrize("name", MADE)
def test_a_page_is_what_its_study_makes_of_its_numbers(name, tmp_path):
    """A page that only a run of hours would write may no longer be made at all."""
    numbers = json.loads((STUDIES / name / "results.json").read_text(encoding="utf-8"))
    MADE[name].write(numbers, tmp_path)
    assert (tmp_path / "README.md").read_text(encoding="utf-8") == (STUDIES / name / "README.md").read_text(encoding="utf-8")
    assert json.loads((tmp_path / "results.json").read_text(encoding="utf-8")) == numbers
