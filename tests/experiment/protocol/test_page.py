"""A board reads every fact of the file, nothing runs over the edge, and no text passes for a line of palpate's own."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from datetime import date, timedelta
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, get_args, get_origin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.protocol import designs, kinds
from palpate.experiment.protocol.approval import Seal, sha256
from palpate.experiment.protocol.approval.sealing import unfilled
from palpate.experiment.protocol.files import ProtocolFile, load, shipped
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Picture, Protocol
from palpate.experiment.protocol.page import approved as approval_lines
from palpate.experiment.protocol.page import page as page_of
from palpate.experiment.session.kinds.tapping.virtual import vibrations
from palpate.experiment.session.runner import MOST_ATTEMPTS
from palpate.experiment.settings.characters import JOINERS, deceptive, hidden, leftward
from tests.experiment.protocol import leveled, tapping
from tests.experiment.protocol.asking import asked
from tests.experiment.protocol.presented import sited
from tests.experiment.protocol.small import before_contact, changed, document, leaves, okamoto2012, protocol, with_text


def page(study: Protocol) -> str:
    return page_of(study, "study.toml")


@lru_cache(maxsize=1)
def unsealed(study: Protocol) -> str:
    """Its page without its hash; the cases of one study follow each other."""
    return page(study).replace(sha256(study), "")


def section(text: str, number: int) -> str:
    """One section of a page, with its heading, as it is laid out."""
    return f"{number}. " + text.partition(f"\n{number}. ")[2].partition(f"\n{number + 1}. ")[0]


def words(text: str) -> str:
    """The words of a page in one line, without the bars of free text."""
    return " ".join(re.sub(r"(?m)^(.{0,20}?)\| ", r"\1", text).split())


def columns(line: str) -> int:
    return sum(2 if unicodedata.east_asian_width(one) in "WF" else 1 for one in line)


def fields(model: BaseModel, at: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any, Any]]:
    """Path, annotation and value of every field, stated or default; where there is None, no value belongs."""
    for name, field in type(model).model_fields.items():
        held = getattr(model, name)
        if isinstance(held, BaseModel):
            yield from fields(held, (*at, name))
        elif isinstance(held, tuple):
            for i, element in enumerate(held):
                if isinstance(element, BaseModel):
                    yield from fields(element, (*at, name, i))
                else:
                    yield (*at, name, i), type(element), element
        elif held is not None:
            yield (*at, name), field.annotation, held


def with_value(model: Any, path: tuple[str | int, ...], new: object) -> Any:
    """A copy with `new` at `path`; unchecked, since the page has to show whatever a protocol holds."""
    part, *rest = path
    if isinstance(part, int):
        return tuple(
            (with_value(one, tuple(rest), new) if rest else new) if i == part else one for i, one in enumerate(model)
        )
    return model.model_copy(update={part: with_value(getattr(model, part), tuple(rest), new) if rest else new})


def others(annotation: Any, value: Any) -> tuple[Any, ...]:
    """Other values that a field of this type might hold."""
    if get_origin(annotation) is Literal:
        return tuple(option for option in get_args(annotation) if option != value)
    match value:
        case bool():
            return (not value,)
        case date():
            return (value + timedelta(days=1),)
        case str():
            return ("Sentinel",)
        case int():
            return (value + 11,)
        case float():
            return (value + 0.125,)
    raise NotImplementedError(f"{annotation} holding {value!r}")


KEPT = changed(changed(document(), ("consent", "kept_months"), 18), ("answers", "microphone"), True)
PROBED = changed(KEPT, ("masker", "probe"), {"material": "felt", "speed_mm_s": 200.0})
LIMITED = changed(PROBED, ("footstep", "synthesis", "left_out_max"), 0.25)
MASKED = changed(changed(LIMITED, ("tasks", 0, "masker"), "white"), ("tasks", 1, "materials"), ("cork",))
SAME = {"test": "equivalence", "tasks": ("one",), "question": "Are felt and cork told apart?", "margin": 0.125}
PAIR = {"test": "one-way ANOVA", "tasks": ("one",), "question": "?", "materials": ("felt", "cork")}
SHARING = {"statement": "May your trials be shared?", "smallest_group": 3, "keep_labels": True}
PLANNED = {**MASKED, "analysis": (*MASKED["analysis"], SAME, PAIR), "sharing": SHARING}
FULL = ProtocolFile.model_validate(changed(PLANNED, ("analysis", 0, "correction"), "materials"))
"""The small protocol with the keys that it leaves out and that have no value of their own then; keeping voices needs a
microphone."""

PAIRS, RENDERED, _ = tapping.STUDIES

NAMES = (*kinds.NAMES, *designs.NAMES)
OWN = [name for name in (f"{tapping.__package__}.{name}" for name in NAMES) if find_spec(name)]
STUDIES: tuple[Protocol, ...] = (FULL, *(study for name in OWN for study in import_module(name).STUDIES))
"""All keys stand in one of these: those of another kind or design in `STUDIES` of a module of its name here."""


def needed(name: str) -> tuple[str, Any]:
    """What a kind or a design cannot do without, and where it stands: its table, if it has one."""
    tables = (getattr(study, name, None) for study in STUDIES)
    return next(((name, table) for table in tables if table is not None), ("materials", FULL.materials))


CASES = [
    (study, path, value, other)
    for study in STUDIES
    for path, kind, value in fields(study)
    for other in others(kind, value)
    if study is FULL or path != ("consent", "voice_recordings")
]
"""With pairs there is no microphone, and so no voice to keep."""

LEVELED = tuple(leveled.protocol(leveled.footsteps(of)) for of in (leveled.STEPS, leveled.WEIGHTED, leveled.EXPECTED))

CASES += [
    (study, path, value, other)
    for study in LEVELED
    for path, kind, value in fields(study)
    for other in others(kind, value)
    if "levels" in path
]


MEASURED = ProtocolFile.model_validate(
    changed(
        changed(document(), ("format",), 7),
        ("footstep", "tactile", "measured"),
        {"file": "thresholds.csv", "sha256": 64 * "a", "whose": "everybody"},
    )
)

CASES += [
    (MEASURED, path, value, other)
    for path, kind, value in fields(MEASURED)
    for other in others(kind, value)
    if "measured" in path
]


GROUPS = {"test": "difference of groups", "tasks": ("one",), "question": "Do they differ?", "groups": "sex"}
ASKED = ProtocolFile.model_validate(
    changed(
        changed({**PLANNED, "format": 7, "analysis": (*PLANNED["analysis"], GROUPS)}, ("asked",), asked("one")),
        ("sharing",),
        {**SHARING, "facts": ("age",), "questionnaires": ("before",)},
    )
)

CASES += [
    (ASKED, path, value, other)
    for path, kind, value in fields(ASKED)
    for other in others(kind, value)
    if path[0] in ("asked", "sharing") or path[-1] == "groups"
]


CASES += [
    (study, path, value, other)
    for study in map(load, map(shipped, ("harder.toml", "timing.toml")))
    for path, kind, value in fields(study)
    for other in others(kind, value)
    if path[0] == "factors" or path[-1] == "ordered"
]


SITED = ProtocolFile.model_validate(sited("palm", "wrist"))

CASES += [
    (SITED, path, value, other)
    for path, kind, value in fields(SITED)
    for other in others(kind, value)
    if "sites" in path or path[-1] == "site"
]


CONTROLLED = ProtocolFile.model_validate(
    changed(
        changed(
            changed(changed(document(), ("format",), 7), ("tasks", 1, "stimulus"), "virtual"),
            ("analysis",),
            tuple({**one, "tasks": ("one",)} for one in (SAME,)),
        ),
        ("tasks", 1, "control"),
        {"of": "one", "arrangement": "Nothing touches the panel."},
    )
)

CASES += [
    (CONTROLLED, path, value, other)
    for path, kind, value in fields(CONTROLLED)
    for other in others(kind, value)
    if "control" in path
]

PHASED = ProtocolFile.model_validate(changed(changed(document(), ("format",), 7), ("tasks", 0, "phase"), "random"))

CASES += [(PHASED, ("tasks", 0, "phase"), "random", other) for other in ("zero", "recorded")]

AHEAD = ProtocolFile.model_validate(before_contact(-20.0, error_max_ms=5.0))

CASES += [
    (AHEAD, path, value, other)
    for path, kind, value in fields(AHEAD)
    for other in others(kind, value)
    if "ahead" in path
]

GROUPED = ProtocolFile.model_validate(
    changed(
        changed(changed(document(), ("format",), 7), ("asked",), asked("one")),
        ("analysis",),
        ({**SAME, "test": "difference of groups", "tasks": ("one",), "margin": None, "groups": "sex"},),
    )
    | {"groups": tuple({"id": name, "description": f"{name} first"} for name in ("shod", "bare"))}
)

CASES += [
    (GROUPED, path, value, other)
    for path, kind, value in fields(GROUPED)
    for other in others(kind, value)
    if "groups" in path
]

PICTURES = tuple(Picture(file=f"{name}.png", sha256=64 * name[0]) for name in ("air", "board"))
PICTURED = ProtocolFile.model_validate(
    changed(changed(document(), ("format",), 7), ("tasks", 0, "pictures"), tuple(map(dict, PICTURES[:1])))
)

CASES += [(PICTURED, ("tasks", 0, "pictures"), "air", other) for other in (PICTURES, PICTURES[1:], None)]


@pytest.mark.parametrize(
    ("study", "path", "value", "other"),
    CASES,
    ids=lambda one: "" if isinstance(one, Protocol) else str(one),
)
def test_the_page_changes_with_every_value(
    study: Protocol, path: tuple[str | int, ...], value: object, other: object
) -> None:
    before, after = study, with_value(study, path, other)
    if len(path) == 3 and path[2] in ("kind", "design"):
        name, table = needed(str(other))
        after = with_value(after, (name,), table)
    shown = page(after)
    assert shown.replace(sha256(after), "") != unsealed(before)
    if other == "Sentinel":
        assert "Sentinel" in shown


def test_the_page_names_no_noise_that_no_task_plays() -> None:
    every = changed(changed(MASKED, ("tasks", 0, "masker"), "white"), ("tasks", 1, "masker"), "none")
    shown = " ".join(page(ProtocolFile.model_validate(every)).split())
    assert "pink" not in shown
    assert "white noise" in shown
    some = " ".join(page(FULL).split())
    assert some.index("pink noise") < some.index("white noise")


def test_every_kind_of_field_was_tried() -> None:
    tried = {path[-1] if isinstance(path[-1], str) else path[-2] for _, path, _, _ in CASES}
    named = {name for model in _models(ProtocolFile) for name, field in model.model_fields.items() if not _holds(field)}
    assert named <= tried


def _models(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    yield model
    for field in model.model_fields.values():
        for inner in _holds(field):
            yield from _models(inner)


def _holds(field: Any) -> list[type[BaseModel]]:
    kinds = [field.annotation, *get_args(field.annotation)]
    return [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]


def test_every_value_of_the_published_study_can_be_read() -> None:
    study = okamoto2012()
    shown = words(page(ProtocolFile.model_validate(study)))
    for path, value in leaves(study):
        if path in (("consent", "required"), ("consent", "voice_recordings")):
            continue
        if isinstance(value, str):
            text = {"repeat-trial": "is repeated", "exclude-participant": "participant is excluded"}.get(value, value)
            text = {"frames-lost": "frames", "speed-below": "less than", "speed-above": "more than"}.get(text, text)
            text = {"answers-below": "answers fewer than", "withdrawn": "withdraws"}.get(text, text)
            assert words(text) in shown, path
        else:
            written = str(int(value)) if float(value).is_integer() else str(value)
            assert re.search(rf"(?<![\d.]){re.escape(written)}(?![\d]|\.\d)", shown), path


def test_sums_for_the_board() -> None:
    # Section 5.1: 40 trials a participant in each task; 60 to 80 min for all procedures. 0.5 s a stimulus: section 3.1.
    shown = words(page(ProtocolFile.model_validate(okamoto2012())))
    assert "virtual 15 4 x 10 = 40 600" in shown
    assert "real 10 4 x 10 = 40 400" in shown
    assert "take 60 to 80 min" in shown
    assert "lasts 20 s" in shown
    # 80 min less two familiarisations of 3 min and a break of 5 min, over 80 trials.
    assert "up to 52 s per" in shown
    assert "11 min to 15 min" in shown


FURTHER = ("ahead", "crossover", "harder", "late", "profile", "sole", "timing", "weight")


@pytest.mark.parametrize("name", FURTHER)
def test_a_shipped_study_leaves_to_its_laboratory_who_sees_the_data(name: str) -> None:
    study = load(shipped(f"{name}.toml"))
    assert set(unfilled(study)) == {"consent.statement", "ethics.board", "ethics.statement"}
    assert all(study.question(task) for task in study.tasks)
    assert study.duration is not None
    most_min = study.exposure.session_min * len(study.tasks)
    most_min += study.task_order.break_min_s / 60 * (len(study.tasks) - 1)
    assert study.duration.shortest_min < most_min < 1.15 * study.duration.longest_min


def test_a_page_names_what_vibrates_and_counts_no_silence() -> None:
    worn, presented = (re.sub(r"\| .*", "", page(load(shipped(f"{name}.toml")))) for name in ("ahead", "sole"))
    assert "vibrating part" in worn
    assert "panel" not in worn + presented
    assert "step" not in presented
    # 6 x 50 trials with a vibration of 1 s each; nothing lasts as long.
    assert "at most 300 s" in words(section(presented, 8))


def test_repeats_end_where_the_session_ends_them() -> None:
    assert f"{MOST_ATTEMPTS} attempts" in words(section(page(protocol()), 9))


def test_a_break_is_told_only_between_tasks() -> None:
    assert "break" not in section(page(load(shipped("sole.toml"))), 4)


def test_what_is_left_for_the_laboratory_is_listed() -> None:
    _, left = page(ProtocolFile.model_validate(okamoto2012())).split("12. Left for the laboratory")
    assert re.findall(r"(?m)^  - (\S+)$", left) == ["ethics.contact"]


def test_what_the_seal_holds_is_not_left_for_the_file() -> None:
    """Filled in after the approval, it would be another version."""
    text = page(ProtocolFile.model_validate(okamoto2012())).partition("2. Participants")[0]
    for name in ("Approval number", "Approved on", "Expires on"):
        assert re.search(rf"(?m)^  {name} +\(in the seal, .*\)$", text)
    stated = page(ProtocolFile.model_validate(changed(document(), ("ethics", "approval_number"), "7")))
    assert "in the seal" not in stated


@pytest.mark.parametrize("study", [protocol(), FULL, RENDERED], ids=["small", "full", "rendered"])
def test_a_board_reads_the_whole_page(study: Protocol, approved: SnapshotAssertion) -> None:
    assert re.sub(r"\b[0-9a-f]{64}\b", "HASH", page(study)) == approved


def test_the_dose_of_noise_and_how_long_a_finger_vibrates_stand_under_the_limits() -> None:
    footsteps, taps = (words(section(page(study), 8)) for study in (protocol(), RENDERED))
    assert "80 dB(A) for 8 hours" in footsteps
    assert "finger" not in footsteps
    # exp(-100 /s * 0.069 s) is a thousandth, and the latest begins 50 ms after the touch.
    assert re.search(r"thousandth .* within 119 ms\.", taps)


def test_nothing_is_left_when_all_is_filled_in(approved: SnapshotAssertion) -> None:
    filled = changed(document(), ("ethics", "contact"), "board@example.org")
    assert section(page(ProtocolFile.model_validate(filled)), 12) == approved


def test_a_protocol_without_duration_or_exclusion_says_so(approved: SnapshotAssertion) -> None:
    bare = {key: value for key, value in document().items() if key not in ("duration", "exclusion")}
    shown = page(ProtocolFile.model_validate(bare))
    assert section(shown, 4) + section(shown, 10) == approved
    assert "  - duration\n" in shown


def test_lines_fit_a_printed_page() -> None:
    long = changed(document(), ("ethics", "contact"), "https://example.org/" + "x" * 300)
    for study in (okamoto2012(), document(), long):
        shown = page(ProtocolFile.model_validate(study))
        assert max(map(len, shown.split("\n"))) <= 92
        assert shown.endswith("\n")
        assert not re.search(r"[ \t]\n", shown)


def test_the_hash_stands_on_the_page() -> None:
    assert sha256(protocol()) in page(protocol())


FORGED = "8. Limits that protect the participant " + "-" * 92 + " Vibration at most 3.0 m/s^2 peak "


@pytest.mark.parametrize("path", [path for path, value in with_text()], ids=str)
@pytest.mark.parametrize("by", [1, 7, 60])
def test_free_text_never_stands_on_a_line_without_a_bar(path: tuple[str | int, ...], by: int) -> None:
    # Wherever lines break, "3.0 m/s^2" and headings come from the text alone, in which every word carries a mark.
    text = "\n".join(f"{word}@" for word in ("x" * by + " " + FORGED * 3).split())
    shown = page(ProtocolFile.model_validate(changed(document(), path, text)))
    outside = [re.sub(r"\| .*", "", line) for line in shown.split("\n")]
    assert "@" in shown
    assert not any("@" in line or "3.0" in line for line in outside)
    assert sum(line.startswith("8. Limits") for line in outside) == 1


def test_a_name_is_never_broken() -> None:
    name = "x Vibration at most 3.0 m/s^2 peak, end"
    assert len(name) == 39
    for words_before in range(12):
        study = changed(
            document(), ("materials", 0, "spoken"), (*(f"w{place:06d}" for place in range(words_before)), name)
        )
        study = changed(changed(study, ("materials", 0, "id"), name), ("exclusion", 0, "id"), name)
        shown = page(ProtocolFile.model_validate(study))
        assert shown.count(f'"{name}"') == 4
        assert "3.0" not in shown.replace(f'"{name}"', "")


@pytest.mark.parametrize(
    "text", ["\uff76\uff01\u30d3\u3000" * 200, "紙" * 500, "cafe\u0301 " * 300, "\u0645\u06cc\u200c\u062e " * 100]
)
def test_wide_characters_do_not_run_over_the_edge(text: str) -> None:
    shown = page(ProtocolFile.model_validate(changed(document(), ("tasks", 0, "instruction"), text)))
    assert max(map(columns, shown.split("\n"))) <= 93
    assert "".join(text.split()) in re.sub(r"\s*\| ", "", shown).replace("\n", "").replace(" ", "")


@given(st.data())
def test_no_accepted_protocol_shows_what_cannot_be_seen(data: st.DataObject) -> None:
    text = data.draw(st.text(st.characters(codec="utf-8"), min_size=1, max_size=12).map(lambda text: f"a{text}z"))
    path = data.draw(st.sampled_from([path for path, _ in with_text()]))
    try:
        study = ProtocolFile.model_validate(changed(document(), path, text))
    except ValueError:
        assert hidden(text, "\n" + JOINERS) or deceptive(text)
        return
    assert not hidden(page(study), "\n" + JOINERS)


@pytest.mark.parametrize("path", [path for path, _ in with_text()], ids=str)
def test_letters_that_run_from_right_to_left_stand_behind_a_bar_alone(path: tuple[str | int, ...]) -> None:
    text = "\u05d0\u05d1 3 \u05d2 " * 40
    shown = page(ProtocolFile.model_validate(changed(document(), path, text)))
    lines = [line for line in shown.split("\n") if leftward(line)]
    assert len(lines) > 3
    assert all(re.match(r" *\| ", line) for line in lines)


def test_a_seal_is_told_in_lines_of_its_own(approved: SnapshotAssertion) -> None:
    days: dict[str, Any] = {"approved_on": date(2020, 2, 1), "expires_on": date(2021, 2, 1)}
    form: dict[str, Any] = {"format": 1, "protocol_sha256": "0" * 64, "protocol": "{}"}
    seal = Seal(approval_number="17 \u05d0", board="Board\nof tests", **form, **days)
    assert approval_lines(seal) == approved


def test_the_file_stands_on_the_page() -> None:
    shown = page_of(protocol(), "a\n\x1b[2Kb.toml")
    assert "  File         | a <U+001B>[2Kb.toml\n" in shown


def test_a_board_reads_what_a_crossover_leaves_of_each_vibration() -> None:
    """The filter, sampled at 48 kHz: rms beside that of the same vibrations whole."""
    crossed, whole = tapping.CROSSED.table(Tapping), ProtocolFile.model_validate(tapping.rendering()).table(Tapping)
    left, of = (
        [float(np.linalg.norm(rings.unit.waveform_m_s2)) for rings in vibrations(one, 48_000).values()]
        for one in (crossed, whole)
    )
    shown = words(page(tapping.CROSSED)).partition("200 mm/s, before the filter: ")[2]
    percent = [float(one) for one in re.findall(r"passes ([0-9.]+) % of the vibration \(rms\)", shown)]
    assert percent == pytest.approx([100 * a / b for a, b in zip(left, of, strict=True)], rel=0.01)
    assert len(percent) == 3


def test_the_margin_of_a_planned_equivalence_is_told() -> None:
    assert "within 0.125; task one; " in words(page(FULL))


def test_the_correction_of_a_planned_test_is_told(approved: SnapshotAssertion) -> None:
    study = ProtocolFile.model_validate(changed(document(), ("analysis", 0, "correction"), "materials and tasks"))
    assert section(page(study), 11) == approved
    assert "Holm's method" not in words(page(protocol()))
