"""A session under way, as a desk sees it: it keeps what was put on record."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from palpate.experiment.desk.link.wire import Choose, Deed, Hello
from palpate.experiment.desk.linked import LinkedConsole
from palpate.experiment.desk.messages import Gauges, Prompt
from palpate.experiment.desk.questions import Remark
from palpate.experiment.records.entries import Purpose
from palpate.experiment.records.progress import Progress
from tests.experiment.session.bench import header


def done(purpose: Purpose, trials: int = 0, answered: int = 0) -> Progress:
    """Return a session's progress: of so many trials so many are answered."""
    named = header("virtual")
    order = tuple(named.order[0].model_copy(update={"trial": trial}) for trial in range(1, trials + 1))
    of = named.model_copy(update={"purpose": purpose, "order": order, "block_trials": max(trials, 1)})
    return Progress(of, said=tuple((trial, "felt") for trial in range(1, answered + 1)))


class Recorded:
    """Implements `Attended`."""

    def __init__(self) -> None:
        self.measured = Gauges(left_s=600, masker_db_a=50, masker_limit_db_a=80)
        self.commands: list[tuple[str, str, bool]] = []
        self.paused = False
        self.shows: list[tuple[Prompt, int]] = []

    def gauges(self) -> Gauges:
        return self.measured

    def done(self) -> Progress:
        return done("STUDY")

    def remark(self, remark: Remark) -> tuple[bool, str]:
        raise AssertionError(f"nobody remarks: {remark}")

    def pause(self, why: str) -> None:
        self.paused = True

    def commanded(self, *, by: str, command: str, taken: bool, words: str) -> None:
        self.commands.append((by, command, taken))

    def shown(self, prompt: Prompt, ago_ns: int) -> None:
        self.shows.append((prompt, ago_ns))


class Inline(Executor):
    """Does in the calling thread whatever it is given."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(fn(*args, **kwargs))
        return done


def untimed(deed: Deed) -> Deed:
    """Return what was asked for, whenever its key was pressed."""
    return deed.model_copy(update={"t_ns": 0, "error_s": None}) if isinstance(deed, Choose) else deed


class Desk(LinkedConsole):
    """A desk that has on record what it is asked when it replies."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._recorder = Inline()

    def take(self, hello: Hello, deed: Deed) -> tuple[bool, str]:
        reply = super().take(hello, deed)
        return reply.result() if isinstance(reply, Future) else reply
