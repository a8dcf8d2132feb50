"""A second rater listens to saved answers, blind to what was presented, keyed and proposed; how far both agree.

They get every answer with a different, no or a narrow proposal, and a random share of the others. Their answers are in
a file that only grows; the first answers stay.
"""

import hashlib
import os
import subprocess
import wave
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from palpate.experiment import storage
from palpate.experiment.clock import utc, wall_ns
from palpate.experiment.dataset import tables
from palpate.experiment.dataset.bids import LABELS
from palpate.experiment.dataset.tables import origin_of
from palpate.experiment.errors import AudioError, DatasetError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain, journal
from palpate.experiment.records.entries import Answer, Correction, Record, Redo, Spoken, Utc

LOG = "second-rater.log"
"""Where a participant's second answers stand, beside the sounds, with which they are deleted."""

LOW_LEAD = 0.2
"""A proposal that leads by less is flagged, in units of agreement: a fifth of how far answers are apart; ours."""


class Second(Record):
    """What a second rater said that an utterance is: an answer, none (`answered` None), or nothing that is `clear`."""

    by: str
    rated_utc: Utc
    sound_sha256: str
    answered: str | None
    clear: bool


@dataclass(frozen=True)
class Utterance:
    """An answer with sound: the experimenter's `first`, as corrected, None for none; `flagged` says why, if it is."""

    file: Path
    sha256: str
    first: str | None
    flagged: str


@dataclass(frozen=True)
class Agreement:
    """How far two raters agree on `pairs` answers, `alike` of them; Cohen's kappa with its 95 % interval.

    J. Cohen, Educational and Psychological Measurement 20 (1960) 37-46; interval of J. L. Fleiss, J. Cohen and B. S.
    Everitt, Psychological Bulletin 72 (1969) 323-327, by statsmodels. None for a single answer throughout, or no pairs.
    """

    pairs: int
    alike: int
    kappa: float | None
    low: float | None
    high: float | None

    @property
    def summary(self) -> str:
        """The agreement in words."""
        if self.kappa is None:
            return f"{self.alike} of {self.pairs} agree; kappa is undefined here"
        return f"{self.alike} of {self.pairs} agree; kappa {self.kappa:.2f}, 95 % CI {self.low:.2f} to {self.high:.2f}"


def flag(spoken: Spoken, answered: str | None) -> str:
    """Return why an answer is to be listened to again, given what was keyed for it; empty if nothing speaks for it."""
    if spoken.onset_s is None:
        return "no speech was detected" if answered is not None else ""
    if spoken.proposed is None:
        return "nothing was proposed"
    if spoken.proposed != answered:
        return "another answer was proposed"
    return "another answer matched almost as well" if spoken.lead < LOW_LEAD else ""


def utterances(root: Path, *, share: float, seed: int) -> tuple[Utterance, ...]:
    """Return what to listen to in a dataset, in an uninformative order; a `share` of the unflagged is drawn by `seed`.

    Raises as `tables.check_tables`, and `DatasetError` for a sound that is not the one on record.
    """
    dataset = tables.check_tables(root)
    withdrawn = dataset.roster.withdrawn if dataset.roster is not None else {}
    found: list[tuple[str, Utterance]] = []
    for path, header in dataset.sessions:
        if header.participant in withdrawn:
            continue
        for one in _recorded_utterances(path, storage.voices_folder(root, header.participant)):
            drawn = hashlib.sha256(f"{seed} {one.sha256}".encode()).hexdigest()
            if one.flagged or int(drawn[:8], 16) < share * 2**32:
                found.append((drawn, one))
    return tuple(one for _, one in sorted(found, key=lambda pair: pair[0]))


def _recorded_utterances(path: Path, folder: Path) -> Iterator[Utterance]:
    """Yield the utterances of a session whose answers count and whose sound is still there."""
    answers: dict[tuple[int, int], str | None] = {}
    spoken: dict[tuple[int, int], Spoken] = {}
    for entry in journal.read(path).entries:
        if isinstance(entry, Answer | Correction):
            answers[entry.trial, entry.attempt] = entry.answered
        elif isinstance(entry, Spoken):
            spoken[entry.trial, entry.attempt] = entry
        elif isinstance(entry, Redo):
            answers.pop((entry.trial, entry.attempt), None)
    for attempt, answered in answers.items():
        said = spoken.get(attempt)
        if said is None or said.sound is None or said.sound_sha256 is None or not (folder / said.sound).exists():
            continue
        file = folder / said.sound
        if hashlib.sha256(storage.read_bytes(file)).hexdigest() != said.sound_sha256:
            raise DatasetError(
                file, "is not the recording that the journal lists", "restore it from a backup, or delete it"
            )
        yield Utterance(file, said.sound_sha256, answered, flag(said, answered))


def rated(root: Path, by: str) -> dict[str, Second]:
    """Return what a second rater said so far, by the hash of the sound, the last of several. Raises `DatasetError`."""
    found: dict[str, Second] = {}
    for log in sorted((root / "sourcedata").glob(f"sub-*/voices/{LOG}")):
        try:
            lines = [Second.model_validate_json(line) for line in storage.read_bytes(log).splitlines() if line]
        except (OSError, ValidationError) as error:
            raise DatasetError(log, "is not a valid file of second answers", "restore it from a backup") from error
        found |= {line.sound_sha256: line for line in lines if line.by == by}
    return found


def put_on_record(one: Utterance, *, by: str, answered: str | None, clear: bool) -> Second:
    """Append what a second rater said of an utterance, on disk when this returns. Raises `DatasetError`."""
    second = Second(by=by, rated_utc=utc(wall_ns()), sound_sha256=one.sha256, answered=answered, clear=clear)
    log = one.file.with_name(LOG)
    try:
        with os.fdopen(os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600), "ab", buffering=0) as file:
            chain.write_through(file, second.model_dump_json().encode() + b"\n")
    except OSError as error:
        raise DatasetError(
            log, f"cannot be written ({error.strerror})", "free some disk space, then try again"
        ) from error
    return second


def have_rated(
    utterances: Sequence[Utterance], protocol: Protocol, *, by: str, present: Callable[[int, Utterance], None],
    ask: Callable[[str], str | None],
) -> dict[str, Second]:  # fmt: skip
    """Ask for each utterance, put each answer on record, and return them by the hash of the sound.

    `present` plays an utterance, with its number, again on request. `ask` returns the key for what is offered; None, or
    the key of a pause, ends it. Raises `DatasetError`, and as `present`.
    """
    keys = {material.key: material.id for material in protocol.materials}
    again, stop = protocol.answers.redo_key, protocol.answers.pause_key
    unclear = next(key for key in "?!.:" if key not in keys)
    others = {
        protocol.answers.no_answer_key: "no answer",
        unclear: "unintelligible",
        again: "play it again",
        stop: "continue later",
    }
    choices = keys | others
    offered = "  ".join(f"[{key}] {words}" for key, words in choices.items())
    seconds: dict[str, Second] = {}
    for number, one in enumerate(utterances, start=1):
        typed: str | None = again
        while typed == again or (typed is not None and typed not in choices):
            if typed == again:
                present(number, one)
            typed = ask(offered)
        if typed is None or typed == stop:
            break
        seconds[one.sha256] = put_on_record(one, by=by, answered=keys.get(typed), clear=typed != unclear)
    return seconds


@dataclass(frozen=True)
class Review:
    """What the second rater `by` is to listen to in a dataset of this `origin`, and their `seconds` so far."""

    protocol: Protocol
    origin: str
    by: str
    utterances: tuple[Utterance, ...]
    seconds: Mapping[str, Second]

    @property
    def left(self) -> tuple[Utterance, ...]:
        """What was not listened to yet."""
        return tuple(one for one in self.utterances if one.sha256 not in self.seconds)

    @property
    def agreements(self) -> dict[str, Agreement]:
        """How far both agree on the answers drawn by chance, and on the flagged ones."""
        return agreements(self.utterances, self.seconds, self.protocol)

    def continued(
        self, play: Callable[[Path], None] | None, *, tell: Callable[[str], None], ask: Callable[[str], str | None]
    ) -> "Review":
        """Have what is left listened to; without `play` files are named. Raises as `have_rated`, and as `play`."""
        left = self.left
        if label := next((text for origin, text in LABELS.items() if origin == self.origin), ""):
            tell(label)

        def present(number: int, one: Utterance) -> None:
            tell(f"Answer {number} of {len(left)}{f': {one.file}' if play is None else ''}")
            if play is not None:
                play(one.file)

        said = have_rated(left, self.protocol, by=self.by, present=present, ask=ask)
        return replace(self, seconds={**self.seconds, **said})

    def as_dict(self) -> dict[str, object]:
        """Return how far both agree, for programs."""
        agreed = {what: asdict(one) for what, one in self.agreements.items()}
        return {"origin": self.origin, "by": self.by, "left": len(self.left), "agreement": agreed}

    def text(self) -> str:
        """Return how far both agree, for a terminal."""
        return "\n".join(
            [
                f"Second rater {self.by}: {len(self.left)} of {len(self.utterances)} answers left.",
                *(f"Answers {what}: {agreement.summary}." for what, agreement in self.agreements.items()),
                "Agreement on randomly drawn answers is representative of the study. Flagged answers are harder to "
                "understand than most.",
            ]
        )


def read_review(root: Path, *, by: str, share: float, seed: int) -> Review:
    """Return the review of a dataset by a second rater, as far as it is. Raises as `utterances` and `rated`."""
    protocol = files.load(storage.protocol_path(root))
    found = utterances(root, share=share, seed=seed)
    return Review(protocol, origin_of(root), by, found, rated(root, by))


def agreements(
    utterances: Sequence[Utterance], seconds: Mapping[str, Second], protocol: Protocol
) -> dict[str, Agreement]:
    """Return how far both raters agree on the answers drawn by chance, and on the flagged ones."""
    found = {}
    for what, flagged in (("drawn at random", False), ("flagged", True)):
        these = [one for one in utterances if bool(one.flagged) is flagged and one.sha256 in seconds]
        pairs = [(one.first, second.answered) for one in these if (second := seconds[one.sha256]).clear]
        found[what] = agreement(pairs, protocol)
    return found


def agreement(pairs: Sequence[tuple[str | None, str | None]], protocol: Protocol) -> Agreement:
    """Return how far first and second answers agree; a pair is one of each, None for no answer."""
    categories = (*(material.id for material in protocol.materials), None)
    table = np.zeros((len(categories), len(categories)))
    for first, second in pairs:
        table[categories.index(first), categories.index(second)] += 1
    alike = int(np.trace(table))
    if not pairs or np.max(np.diag(table)) == len(pairs):
        return Agreement(len(pairs), alike, None, None, None)
    from statsmodels.stats.inter_rater import cohens_kappa

    with np.errstate(divide="ignore", invalid="ignore"):
        found = cohens_kappa(table)
    kappa, low, high = (float(each) for each in (found.kappa, found.kappa_low, found.kappa_upp))
    if not np.isfinite([kappa, low, high]).all():
        return Agreement(len(pairs), alike, None, None, None)
    return Agreement(len(pairs), alike, kappa, max(low, -1.0), min(high, 1.0))


def play(file: Path, player: str | None) -> None:
    """Play a sound to its end by a command, or on this machine's default output. Raises `AudioError`."""
    remedy = "choose another player with --player, or print the paths with --paths"
    if player is not None:
        try:
            done = subprocess.run([*player.split(), str(file)], capture_output=True, check=False)  # noqa: S603
        except OSError as error:
            raise AudioError(f"player '{player}'", storage.why(error), remedy) from error
        if done.returncode:
            raise AudioError(f"player '{player}'", f"ended with {done.returncode}", remedy)
        return
    from palpate.experiment.apparatus.audio.stream import library

    sounddevice = library()
    with wave.open(str(file)) as sound:
        rate_hz, samples = sound.getframerate(), np.frombuffer(sound.readframes(sound.getnframes()), "<i2")
    try:
        # A voice before a microphone is soft; whoever listens hears every one as loud.
        sounddevice.play(samples / max(2.0 * float(np.max(np.abs(samples), initial=0)), 1.0), rate_hz, blocking=True)
    except (sounddevice.PortAudioError, ValueError) as error:
        raise AudioError("this machine's default output", str(error), remedy) from error
