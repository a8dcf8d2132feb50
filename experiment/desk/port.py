"""What a session needs of the experimenter's screen and keys; each console is one file that implements it."""

from collections.abc import Sequence
from typing import Protocol

from palpate.experiment.apparatus.ports import Rester
from palpate.experiment.clock import Clock, minutes
from palpate.experiment.desk.messages import Correct, Gauges, Prompt, Repeat, Standing, TakeNote

Remark = TakeNote | Correct | Repeat
"""What the experimenter may say instead of answering a question."""


class Attended(Protocol):
    """A session under way, or one that paused, as a desk may ask of it at any moment, from any thread."""

    def gauges(self) -> Gauges | None:
        """Return what is measured now; None in a pause."""

    def standing(self) -> Standing:
        """Return how far the session is."""

    def remark(self, remark: Remark) -> tuple[bool, str]:
        """Return whether a remark was taken, and in words what was done, or why not."""

    def pause(self, why: str) -> None:
        """Have nothing felt from now on, and the session pause where no question is open, as `why` says."""

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        """Put on record what was asked for, by whom, and what was replied."""

    def shown(self, prompt: Prompt, ago_ns: int) -> None:
        """Put on record what the participant's screen shows, and that it has done so for `ago_ns`."""


class Console(Rester, Protocol):
    """What the experimenter sees and keys, without deciding what comes next; what it leaves out does nothing.

    A console may raise `PauseAsked` from whatever it waits in, and `LinkError` once nobody can reach it.
    """

    def attend(self, session: Attended | None) -> None:  # noqa: ARG002
        """Follow the session under way or paused from now on, None for none; all work for the one before has ended."""
        return

    def at(self, *, step: str, steps: Sequence[str]) -> None:  # noqa: ARG002
        """Say where the visit stands: at one of its steps."""
        return

    def agree(self, *, text: str, yes: str, no: str) -> bool:
        """Wait until the experimenter says `yes` or `no` to what `text` says."""

    def write(self, *, text: str) -> str:
        """Wait for what the experimenter writes down as `text` asks for; it may be nothing."""

    def wait(self, *, why: str, until_ns: int, clock: Clock) -> None:
        """Return when a session's clock has reached a time, ns."""

    def goes_on(self, *, why: str) -> bool:  # noqa: ARG002
        """Return whether the program goes on with a session that stopped; `why` says how it stopped."""
        return False

    def show(self, text: str) -> None:
        """Show the experimenter a line."""

    def stopped(self) -> None:
        """Take note, in any thread, that the participant stopped everything with the pedal."""
        self.show(STOPPED)

    def familiarise(self, *, instruction: str, min_s: float, max_s: float, handled: dict[str, str]) -> str:
        """Return a key of `handled`, of a material that the participant handled, or "" once they know them all."""

    def instruct(self, *, instruction: str) -> None:  # noqa: ARG002
        """Show what the participant is told to do, until they have answered a first trial."""
        return

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        """Return one of `keys`, to change the masker's level, or "" to keep it because `criterion` holds."""

    def say(self, *, words: str, take: int, takes: int, why: str) -> bool:
        """Return whether the participant now says `words`, as take `take` of `takes`; False is without a microphone.

        `why` says why the take before was not used.
        """

    def place(self, *, trial: int, presented: tuple[str, ...]) -> None:
        """Return when the real object has been laid out, or, of a pair, both."""

    def arm(self, *, trial: int, attempt: int, trials: int) -> bool:
        """Announce trial `trial` of `trials`, armed from now on; return whether the experimenter was waited for."""

    def rearm(self, *, trial: int, attempt: int, reason: str) -> bool:
        """Say that a step broke off, why, and that the trial is armed again; return as `arm` does."""

    def waiting(self) -> None:
        """Say that a device is silent, and that no step counts until the next `arm`."""
        return

    def ask(self, *, trial: int, answers: dict[str, str], others: dict[str, str]) -> str | Remark:
        """Wait for a key of `answers` or `others` (key -> what it stands for), or a remark, and return it."""

    def chosen_ago_ns(self) -> int:
        """Return how long ago the last question was answered by a key, ns: it may have gone on record since."""
        return 0

    def heard(self, *, words: str) -> None:
        """Show what the microphone seems to have heard, which decides nothing; it may be called from any thread."""
        self.show(words)

    def confirm(self, *, key: str, meaning: str) -> bool:
        """Return whether the experimenter stands by the key that was chosen."""

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        """Say that the answer is on disk."""

    def debrief(self) -> Remark | None:
        """Wait, once all trials are answered, for a remark, or for the end of the session: None."""

    def ignored(self) -> str:
        """Return what was typed before it was asked for, since this was called last; it answered nothing."""


def lasting(min_s: float, max_s: float) -> str:
    """Return in a sentence how long a familiarisation may still last."""
    if max_s <= 0:
        return "Familiarisation: its longest time is over."
    return f"Familiarisation, {minutes(min_s) if min_s > 0 else 'up'} to {minutes(max_s)}."


def laid_out(presented: tuple[str, ...]) -> str:
    """Return in words what is to be laid out: one object, or a pair with the place of each."""
    return presented[0] if len(presented) == 1 else f"{presented[0]} as the first and {presented[1]} as the second"


BY_EXPERIMENTER, BY_PARTICIPANT = "by the experimenter", "by the participant"
"""Why a session pauses that was asked to."""

STOPPED = "The participant stopped everything: the session pauses."
"""What is shown then, and is on record of the pedal."""

LAB_BOOK, NOT_ANCHORED = "For the lab book: ", "NOT ANCHORED: "
"""How lines begin that are told again at the program's end: they are to be copied, or acted on."""

NO_ANSWER = "no answer"
"""What the key stands for that says that the participant said nothing."""

INTERRUPTED = "interrupted at the keyboard"
"""Why a session pauses whose process was sent a signal, by Ctrl-C as a rule."""

YES, NO = "y", "n"
"""The keys that say whether something is so: not Enter, which most questions take, and which ends a pasted command."""

WITHOUT = "x"
"""The key that goes on without a microphone."""

DEBRIEFING = "debriefing"
"""The last step of a visit."""

RESTS = (
    "Zeroing: have the foot rest still on the bare panel. Then press Enter, or press Ctrl-C to pause; the same command "
    "continues: "
)
"""What sessions and recordings both ask of the experimenter before the tracker is zeroed."""
