"""What the console draws of a view, as texts of rich; keys and commands carry `PRESSES` in their style, for clicks."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from statistics import median

from rich.style import Style
from rich.table import Table
from rich.text import Text

from palpate.experiment.desk.link.wire import Asked, Standing, Told, View
from palpate.experiment.desk.messages import ENTER, Choice, Gauges, Lamp

PRESSES = "presses"
"""The name under which a style carries the key that a click on the text presses."""

COMMANDS = {
    "f2": ("F2", "note"),
    "f3": ("F3", "correct"),
    "f4": ("F4", "repeat"),
    "f5": ("F5", "event"),
    "f6": ("F6", "break"),
    "f7": ("F7", "pause"),
    "f8": ("F8", "stop"),
    "f9": ("F9", "leave"),
}
"""Keys that no answer of a protocol can have, as they are shown, and what they do."""

REVEAL, REVEALS = "f1", ("F1", "show")
"""The key that has results shown, where the protocol allows it, with its cap and what it does."""

NAMES = 6
"""A material's name has so many cells at least beside its counts."""

NAMED = {
    "enter": "Enter",
    "escape": "Esc",
    " ": "Space",
    REVEAL: REVEALS[0],
    **{key: cap for key, (cap, _) in COMMANDS.items()},
}
"""Keys that are no characters, or none that can be seen, as they are shown."""

BARS = " ▁▂▃▄▅▆▇█"

DIM, PLAIN = "#9aa4ad", "#e8edf0"
GOOD, BAD, UNKNOWN = "#4cc27a", "#ff6b5e", "#9aa4ad"
BLUE, YELLOW, VIOLET, WHITE = "#2f6fde", "#f2c230", "#c13c9b", "#e8edf0"
GREY, RED, ORANGE = "#56616a", "#c62f26", "#d9822b"
TRACE = "#7fb3ff"
OFF, UNLIT = "#1c252c", "#5d6a74"


@dataclass(frozen=True)
class Phase:
    """The present phase: its word, its place on the strip (else the first), its color, and a sentence."""

    word: str
    place: str
    colour: str
    says: str = ""

    @property
    def ink(self) -> str:
        """The colour of the word on this colour."""
        return "#000000" if self.colour in (YELLOW, WHITE, ORANGE) else "#ffffff"


STIMULI, PAIRS, VIRTUAL = ("", "ARMED", "STIMULUS", "ANSWER"), ("", "LAY OUT", "ANSWER"), ("", "ANSWER")
"""The strips of stimuli, comparisons, and virtual surfaces, from left to right; first the place for all else."""

ASKED = {
    "agree": Phase("AGREE?", "", ORANGE),
    "write": Phase("WRITE", "", ORANGE),
    "familiarise": Phase("FAMILIARIZE", "", ORANGE),
    "level": Phase("MASKER", "", ORANGE),
    "say": Phase("SAY", "", ORANGE),
    "rest": Phase("REST FOOT", "", ORANGE),
    "place": Phase("LAY OUT", "LAY OUT", ORANGE),
    "play": Phase("PRESENT", "ARMED", ORANGE),
    "answer": Phase("ANSWER", "ANSWER", VIOLET),
    "confirm": Phase("CONFIRM", "ANSWER", WHITE),
    "debrief": Phase("DEBRIEF", "", ORANGE),
    "break": Phase("BREAK", "", GREY),
    "continue": Phase("PAUSED", "", GREY),
}
"""By the kind of the question that is asked."""

STATES = {
    "preparing": Phase("PREPARING", "", GREY, "The session is preparing the next step."),
    "familiarising": Phase("FAMILIARIZE", "", GREY, "The participant is handling the materials."),
    "armed": Phase("ARMED", "ARMED", BLUE, "Waiting for the participant, who may {may}."),
    "answering": Phase("ANSWER", "ANSWER", GREY, "The answer is being saved."),
    "waiting": Phase(
        "WAITING", "", RED, "A device is not responding (see below). The session continues once it responds."
    ),
    "paused": Phase("PAUSED", "", GREY, "The session is paused."),
    "ended": Phase("ENDED", "", GREY, "The session has ended."),
}
"""Where nothing is asked, by the session's state."""

LEFT = 130
"""The exit code of a session that the experimenter chose to leave."""

FAILED = Phase("FAILED", "", RED)
"""A session whose process ended with a fault."""

TRYING = Phase("ANSWER", "ANSWER", GREY, "The participant is exploring both surfaces. The question comes next.")
STEPPED = Phase("ANSWER", "ANSWER", GREY, "The step counts. The question comes next.")
STEPPING = Phase("STEPPING", "STIMULUS", YELLOW, "The foot is moving. The question comes after it lands.")
AGAIN = Phase("AGAIN", "ARMED", BLUE, "The last attempt did not count. {why}. The participant may {may} again.")
DONE = Phase("TASK DONE", "", ORANGE)
GONE = Phase("GONE", "", RED)


def phase(view: View) -> Phase:
    """Return what happens now."""
    if view.ended is not None and view.ended.exit_code not in (0, LEFT):
        return FAILED
    if view.question is not None:
        if view.question.kind == "debrief" and view.step in view.steps[:-1]:
            return DONE
        return ASKED[view.question.kind]
    if view.state == "armed" and view.gauges is not None and (view.gauges.stepped or view.gauges.moving):
        return STEPPED if view.gauges.stepped else STEPPING
    if view.state == "armed" and view.interval is not None:
        return Phase(f"INTERVAL {view.interval}", "STIMULUS", YELLOW, "A stimulus is playing. The question comes next.")
    if view.state == "armed":
        now = AGAIN if view.again else STATES["armed"]
        return replace(now, says=now.says.format(may=view.may, why=view.again))
    return TRYING if view.at_will and view.may and view.state == "answering" else STATES[view.state]


def strip(view: View) -> tuple[str, ...]:
    """Return the places of the strip, from left to right."""
    virtual = view.gauges is not None and view.gauges.too_fast is not None
    return STIMULI if not view.at_will else VIRTUAL if virtual else PAIRS


def heading(label: str, study: str, participant: str, task: str) -> Text:
    """Return who takes part in what, after a label that no study has."""
    facts = (study, participant and f"participant {participant}", task and f"task {task}")
    return Text.assemble(
        (f" {label} " if label else "", f"bold #000000 on {YELLOW}"),
        " " if label else "",
        " · ".join(filter(None, facts)),
    )


def visit(step: str, steps: tuple[str, ...]) -> Text:
    """Return the steps of a visit with the one under way among them."""
    told = Text(style=DIM)
    for number, name in enumerate(steps):
        told.append(" › " if number else "")
        told.append(name, style=f"bold {PLAIN}" if name == step else "")
    if step and step not in steps:
        told.append(step, style=f"bold {PLAIN}")
    return told


def counted(trial: int | None, trials: int, remaining: int | None, attempt: int) -> Text:
    """Return, in three lines, of how many trials this is one, and how many are to be answered; None for a training."""
    if not trials:
        return Text()
    again = f"attempt {attempt}" if attempt > 1 and trial is not None else ""
    todo = "training" if remaining is None else f"{remaining} to do"
    return Text(f"{'of ' if trial is not None else ''}{trials}{' trials' if trial is None else ''}\n{todo}\n{again}")


def keycap(key: str) -> str:
    """Return a choice's key as it is shown."""
    return NAMED.get(key, key)


def lines(told: tuple[str, ...]) -> Text:
    """Return the lines of the session, the newest last."""
    text = Text("\n".join(told[:-1]), style=DIM)
    text.append("\n" if text else "")
    return text.append("".join(told[-1:]), style=PLAIN)


def hint(words: str, does: str, *, fields: int) -> Text:
    """Return what may be filled in, the keys that end a form, and the one that changes between its fields."""
    text = Text(f"{words}\n" if words else "", style=DIM)
    text.append_text(_cap("enter")).append(f" {does}   ", style=Style(meta={PRESSES: "enter"}))
    text.append_text(_cap("escape")).append(" closes this", style=Style(meta={PRESSES: "escape"}))
    return text.append("   Tab changes the field" if fields > 1 else "", style=DIM)


def offered(choices: tuple[Choice, ...], roomy: bool, large: int = 0) -> Table:
    """Return the keys that may be pressed: each answer in a row of its own, and what else there is together below.

    `large` is in how many columns answers with keys of three rows stand, 0 for keys of one row.
    """
    apart = [choice for choice in choices if choice.answer] or list(choices)
    both = Table.grid(expand=True)
    both.add_column(ratio=1)
    both.add_row(_large(apart, large) if large else _small(apart, roomy))
    others = [choice for choice in choices if choice not in apart]
    if others:
        pairs = Table.grid(padding=(0, 1))
        for one, other in zip_longest(others[::2], others[1::2]):
            pairs.add_row(*(part for choice in (one, other) if choice is not None for part in _other(choice)))
        if not roomy:
            both.add_row("")
        both.add_row(pairs)
    return both


def _small(choices: Sequence[Choice], roomy: bool) -> Table:
    grid = Table.grid(padding=(0, 1, 1 if roomy else 0, 0), expand=True)
    grid.add_column(no_wrap=True)
    grid.add_column(ratio=1, overflow="fold")
    for choice in choices:
        grid.add_row(_cap(choice.key), _words(choice))
    return grid


def _large(choices: Sequence[Choice], columns: int) -> Table:
    """Return choices whose keys are three rows high, in columns from top to bottom."""
    grid = Table.grid(padding=(0, 2), expand=True)
    for _ in range(columns):
        grid.add_column(no_wrap=True)
        grid.add_column(ratio=1, overflow="fold", vertical="middle")
    rows = math.ceil(len(choices) / columns)
    for row in range(rows):
        if row:
            grid.add_row()
        grid.add_row(*(part for one in choices[row::rows] for part in (_cap(one.key, high=True), _words(one))))
    return grid


def _words(choice: Choice) -> Text:
    return Text(choice.words, style=Style.parse(f"bold {PLAIN}") + Style(meta={PRESSES: choice.key}))


def _other(choice: Choice) -> tuple[Text, Text]:
    return _cap(choice.key), Text(choice.words, style=Style.parse(DIM) + Style(meta={PRESSES: choice.key}))


def _cap(key: str, *, high: bool = False) -> Text:
    shown, pressed = keycap(key), Style.parse(f"bold #000000 on {PLAIN}") + Style(meta={PRESSES: key})
    if not high:
        return Text(f" {shown} ", style=pressed)
    blank = " " * (len(shown) + 6)
    return Text(f"{blank}\n   {shown}   \n{blank}", style=pressed)


def question_text(question: Asked | None, now: Phase, lay_out: str, heard: str, large: bool) -> Text:
    """Return what is asked, or that nothing is, and what the microphone proposes; bold throughout if `large`."""
    told = Text()
    if lay_out and (question is None or question.kind != "place"):
        told.append(f"Laid out: {lay_out}\n", style=DIM)
    if question is None:
        colour = YELLOW if now.word == AGAIN.word else PLAIN if large else DIM
        return told.append(now.says, style=f"bold {colour}" if large else colour)
    big = large or question.kind in ("place", "confirm", "answer")
    told.append("Confirm: " if question.kind == "confirm" else "", style=f"bold {DIM}" if large else DIM)
    told.append(question.text, style=f"bold {PLAIN}" if big else PLAIN)
    return told.append(f"\n{heard}" if heard and question.kind in ("answer", "confirm") else "", style=YELLOW)


def trace(values: tuple[float, ...], unit: str, width: int, rows: int) -> Text:
    """Return a trace as bars, the newest at the right; its lowest line is 0, or the least value below."""
    if not values:
        return Text("No movement", style=DIM)
    low, high = min(0.0, *values), max(values)
    span = (high - low) or 1.0
    scale = f"{high:.0f} {unit}"
    wide = max(1, width - len(scale) - 1)
    columns = [values[column * len(values) // wide] for column in range(wide)]
    eighths = [round((value - low) / span * rows * 8) for value in columns]
    drawn = ["".join(BARS[min(8, max(0, each - 8 * row))] for each in eighths) for row in reversed(range(rows))]
    # The greatest value stands at its height.
    rest = "".join(f"\n{line}" for line in drawn[1:])
    return Text.assemble((drawn[0], TRACE), (f" {scale}", DIM), (rest, TRACE))


def gauges(told: Gauges, roomy: bool, width: int) -> Text:
    """Return the measured values in words, movement only where it is measured; faulty parts come with lamps."""
    text = Text()
    if told.trace_unit and told.last:
        text.append(f"Last: {told.last}\n")
    if told.masker_limit_db_a is not None:
        level = "silent" if told.masker_db_a is None else f"{told.masker_db_a:.0f} dB(A)"
        most = f", at most {told.masker_limit_db_a:.0f}" if roomy else ""
        dose = f", dose {told.dose:.0%}" if told.dose is not None else ""
        text.append("Masker: ", style=DIM).append(f"{level}{most}{dose}\n")
    if told.trace_unit:
        stimuli = "stimulus" if told.stimuli == 1 else "stimuli"
        text.append("Felt: ", style=DIM).append(f"{told.stimuli} {stimuli}, {told.vibration_s:.1f} s\n")
        text.append_text(delivered(told.delivered)).append("\n")
    return text.append_text(lamps(told.lamps, roomy=roomy, width=width))


def delivered(was: bool | None) -> Text:
    """Return how the last stimulus was delivered."""
    words = {True: "delivered as intended", False: "NOT delivered as intended", None: "delivery not measured"}[was]
    return _lamp(was, words)


def lamps(told: tuple[Lamp, ...], *, roomy: bool, width: int) -> Text:
    """Return the health of every part, faults first with words; the others have words if `roomy`, or fill `width`."""
    text, brief_before = Text(), False
    for lamp in sorted(told, key=lambda one: (one.good is not False, one.good is not None)):
        brief = lamp.good is True and not roomy
        shown = _lamp(lamp.good, lamp.name if brief else f"{lamp.name}: {lamp.words}")
        used = len(text.plain.rsplit("\n", 1)[-1])
        beside = brief and brief_before and used + 2 + len(shown.plain) <= width
        text.append("" if not text else "  " if beside else "\n").append_text(shown)
        brief_before = brief
    return text


def _lamp(good: bool | None, words: str) -> Text:
    sign, colour = {True: ("●", GOOD), False: ("▲", BAD), None: ("○", UNKNOWN)}[good]
    return Text.assemble((f"{sign} ", f"bold {colour}"), (words, f"bold {BAD}" if good is False else ""))


def recent(told: tuple[Told, ...]) -> Text:
    """Return the last answers, the newest first; never what was presented."""
    text = Text("Last answers" if told else "", style=DIM)
    for one in reversed(told):
        number = f"{one.trial}".rjust(len(str(max(each.trial for each in told))))
        text.append(f"\n{number} ", style=DIM)
        text.append(one.words, style=PLAIN)
        text.append(", corrected" if one.corrected else "", style=YELLOW)
    return text


def measures(standing: Standing, steps: bool) -> Text:
    """Return what a session measured so far, two lines each; with `steps` their speeds."""
    text = _cell("Response time", _newest(standing.responses_s, "s", 1), standing.responses_s)
    if steps:
        text.append("\n").append_text(_cell("Speed", _newest(standing.speeds_mm_s, "mm/s", 0), standing.speeds_mm_s))
    return text


def _cell(title: str, value: str, series: Sequence[float]) -> Text:
    """Return a title, a value, and below them a series as bars from zero on, the newest at the right."""
    most = max(series, default=0.0) or 1.0
    bars = "".join(BARS[1 + round(7 * max(value, 0.0) / most)] for value in series)
    return Text.assemble((f"{title}: ", DIM), (f"{value}\n", PLAIN), (bars, TRACE))


def _newest(values: Sequence[float], unit: str, digits: int) -> str:
    """Return the last value and the median of all."""
    if not values:
        return "none yet"
    return f"{values[-1]:.{digits}f} {unit}, median {median(values):.{digits}f}"


def results(standing: Standing, answers: Sequence[Choice], width: int) -> Text:
    """Return how often each answer was given to what was presented, in a column of its key where all have room, and
    the levels of tracks.
    """
    text = Text("Answers by material", style=DIM)
    keys = {choice.words: choice.key for choice in answers}
    cell = 1 + max((len(str(times)) for one in standing.tallies for _, times in one.answers), default=1)
    names = width - cell * len(keys)
    rows = _matrix(standing, keys, names, cell) if keys and names >= NAMES else _listed(standing)
    for name, counts in rows:
        text.append("\n").append_text(name).append(counts, style=PLAIN)
    others = standing.answered - sum(times for one in standing.tallies for _, times in one.answers)
    text.append(f"\nother answers: {others}" if others else "", style=DIM)
    for track in standing.tracks:
        last = f"last {track.levels[-1]:.3g}"
        text.append("\n").append_text(_cell(f"Level of {track.name}", last, track.levels))
    return text


def _matrix(standing: Standing, keys: Mapping[str, str], names: int, cell: int) -> Iterator[tuple[Text, str]]:
    """Yield a row of keys, and one a material: its name in so many cells, and a count for each key, empty for none."""
    yield Text(" " * names), "".join(key.rjust(cell) for key in keys.values())
    for one in standing.tallies:
        name, counts = Text(one.presented, style=DIM), dict(one.answers)
        name.truncate(names, overflow="ellipsis", pad=True)
        yield name, "".join(str(counts.get(said, "")).rjust(cell) for said in keys)


def _listed(standing: Standing) -> Iterator[tuple[Text, str]]:
    """Yield each material's name, and its answers in words, the most frequent first."""
    for one in standing.tallies:
        yield Text(f"{one.presented}: ", style=DIM), ", ".join(f"{said} {times}" for said, times in one.answers)


def time_left(left_s: float) -> str:
    """Return how much of a session's time is left, in words."""
    if left_s <= 0:
        return "No time is left"
    return f"{left_s / 60:.0f} min left" if left_s >= 120 else f"{left_s:.0f} s left"


def countdown(left_s: float) -> str:
    """Return what is left of a break, in minutes and seconds, of which the last has begun: 0:00 is its end."""
    whole = max(0, math.ceil(left_s))
    return f"{whole // 60}:{whole % 60:02d}"


def counts_down(question: Asked | None, lasts: bool) -> Text:
    """Return what the numbers of a countdown are: of a break, or of a familiarisation before and after its least."""
    if question is None or question.kind != "familiarise":
        return Text("left of\nthe break" if lasts else "The break\nis over.")
    early = ENTER not in {choice.key for choice in question.choices}
    return Text("until Enter\nworks" if early else "left\nat most" if lasts else "The time\nis over.")


def commands(wide: bool, reveals: bool) -> Text:
    """Return the commands that may be given at any moment; `reveals`: among them the one that shows results."""
    text, all_of_them = Text(), ({REVEAL: REVEALS} if reveals else {}) | COMMANDS
    for key, (cap, does) in all_of_them.items():
        if text:
            text.append(" " * (1 if not wide else 2 if reveals else 4))
        meta = Style(meta={PRESSES: key})
        text.append(f" {cap} " if wide else cap, style=Style.parse(f"bold #000000 on {DIM}") + meta)
        text.append(f" {does}", style=Style.parse(PLAIN) + meta)
    return text
