"""A session's desk whose console and participant's screen are processes of their own, at the other end of a link.

The session waits here for keys from the link's thread; another thread waits for disks. A key counts only for the
question on the screen when it was pressed. Without a console nothing new is armed, and then the session pauses.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from math import inf

from palpate.experiment.apparatus import host
from palpate.experiment.clock import Clock, monotonic_ns, wall_ns
from palpate.experiment.desk import port, prompts
from palpate.experiment.desk.messages import (
    CLOSED,
    ENTER,
    ESCAPE,
    LINES,
    SAFE,
    TYPED,
    Choice,
    Choose,
    Correct,
    Deed,
    Ended,
    Gauges,
    Hello,
    Kind,
    Lamp,
    Message,
    Pause,
    Prompt,
    Question,
    Repeat,
    Shown,
    Stop,
    TakeNote,
    Typed,
    View,
    Write,
)
from palpate.experiment.desk.prompts import NOTHING, Theirs
from palpate.experiment.errors import LinkError, PalpateError, PauseAsked
from palpate.experiment.settings import characters

ALONE_S = 600.0
"""After so long without a console the session pauses, s."""

SCREEN_S = 60.0
"""Nothing is armed for so long, s, while the participant's screen opens; PsychoPy takes some ten to load."""

SCREEN_OPENS = "The participant's screen opens; that takes some seconds. The trial is armed once it is there."

KEEPS_STATE = ("answer", "confirm", "familiarise", "break", "continue")
"""Questions that belong to a state of the session; while any other is asked, and after it, what comes is prepared."""

PATIENCE_NS = 300_000_000
"""After so long without anything to show the participant is asked to wait, ns."""

PROMPTS = 20
"""So many prompts are remembered, for the participant's screen to say when it showed them."""

STOP = "s"
"""The key that ends the process of a session that paused."""

EARLY = (Choice(key=ENTER, words="end the break"), Choice(key=ESCAPE, words="go on with the break"))
"""What ends a break before its time: a key that is leaned on is one press, and no answer to this."""

NEXT = "── Task {step} ──"
"""The line between what was told of one task and what is told of the next."""

UNWRITABLE = "The text {}, which cannot go on record; write it without that character."

NO_SESSION = (
    "No session has begun or is open, and nothing can go on record now. Keep it on paper, and note it here once one is."
)


class LinkedConsole:
    """Implements `Console` and the link's `SessionEnd`."""

    def __init__(self, view: View, *, theirs: Theirs = NOTHING, screen: bool = False, alone_s: float = ALONE_S) -> None:
        """Begin with `view`, which does not change; `theirs` is at the participant's screen, if there is a `screen`."""
        self._view = view
        self._alone_s = alone_s
        self._changed = threading.Condition()
        # What waits for the disk, one after the other, so that the link's thread does not.
        self._recorder: Executor = ThreadPoolExecutor(1, "recorder", initializer=host.favour)
        self._session: port.Attended | None = None
        self._asked = 0
        self._chosen: str | None = None
        self._chosen_at_ns = 0
        self._picked: tuple[Deed, int, str] | None = None
        self._repeated: Repeat | None = None
        self._consoles = 0
        self._theirs = theirs
        self._screen = self._awaits_screen = screen
        self._screens = 0
        self._prompts = [Prompt()]
        # No screen showed anything of a session before its desk began; another clock's reading may be a second off.
        self._began_ns = monotonic_ns() - 10**9
        self._armed: int | None = None
        self._waits_ns: int | None = None
        self._pausing: Pause | Stop | None = None
        self._paused_by = port.BY_EXPERIMENTER
        self._failed = ""
        self._ignored = ""
        self._anchored = ""
        self.wake: Callable[[], None] = lambda: None
        """Called when there is something new to tell."""

    # What the link asks, from its thread.

    def tell(self, role: str) -> Message:
        with self._changed:
            view, session = self._view, self._session
        if session is not None:
            measured = session.gauges()
            gauges = self._with_screen(measured) if measured is not None else None
            view = view.model_copy(update={"gauges": gauges, **_standing(session)})
        return view if role == "console" else self._prompt(view)

    def _with_screen(self, gauges: Gauges) -> Gauges:
        if not (self._screen or self._screens):
            return gauges
        there = self._screens > 0
        words = "connected" if there else "not connected; `palpate screen` opens it"
        return gauges.model_copy(update={"lamps": (*gauges.lamps, Lamp(name="screen", good=there, words=words))})

    def _prompt(self, view: View) -> Prompt:
        """Return what the participant's screen shows, with a number that changes when its look does."""
        last = self._prompts[-1]
        new = prompts.prompt(view, self._theirs)
        if new.show != "wait" or last.show == "wait":
            self._waits_ns = None
        else:
            self._waits_ns = self._waits_ns or monotonic_ns()
            if monotonic_ns() - self._waits_ns < PATIENCE_NS:
                return last
        same = new.model_copy(update={"number": last.number})
        if same.model_copy(update={"question": last.question, "hand_mm": last.hand_mm}) == last:
            self._prompts[-1] = same
        else:
            self._prompts = [*self._prompts[1 - PROMPTS :], new.model_copy(update={"number": last.number + 1})]
        return self._prompts[-1]

    def came(self, consoles: int, screens: int) -> None:
        with self._changed:
            self._screens = screens
            self._screen = self._screen or screens > 0
            if 1 <= self._consoles < consoles:
                self.show(
                    f"Another console was opened; {consoles} are open. The first key pressed at any of them counts."
                )
            elif 1 <= consoles < self._consoles:
                self.show("Another console was closed.")
            self._consoles = consoles
            self._changed.notify_all()

    def lost(self, why: str) -> None:
        with self._changed:
            self._consoles = self._screens = 0
            self._failed = f"the link to the consoles failed ({why}); run the same command again, and report this"
            self._changed.notify_all()
        if self._session is not None:
            # What is waited for outside of questions, a foot as a rule, ends too.
            self._session.pause(self._failed)

    def take(self, hello: Hello, deed: Deed) -> tuple[bool, str] | Future[tuple[bool, str]]:
        try:
            done = self._take_at_once(deed) if hello.role == "console" else self._take_choice(deed)
        except ValueError as error:
            done = False, UNWRITABLE.format(error)
        recorded = self._recorder.submit(self._record, hello, deed, done)
        # These alone count before they are on record.
        return done if done is not None and isinstance(deed, Pause | Stop) else recorded

    def _record(self, hello: Hello, deed: Deed, done: tuple[bool, str] | None) -> tuple[bool, str]:
        """Do what only a disk that answers allows; return whether the deed was taken, and the reply."""
        session = self._session
        try:
            taken, words = done or self._take_remark(deed, session)
        except ValueError as error:
            taken, words = False, UNWRITABLE.format(error)
        except PalpateError as error:
            return False, str(error)
        # What was typed and what was shown have entries of their own.
        if session is not None and not (taken and isinstance(deed, Typed | Shown)):
            # The words of a remark stand in its own entry.
            facts = deed.model_dump(exclude={"do", "text", "reason"}, exclude_none=True)
            command = " ".join([deed.do, *map(str, facts.values())])
            try:
                session.commanded(by=hello.by, command=command, taken=taken, words=words)
            except PalpateError as error:
                # The session meets it too, and ends.
                taken, words = False, str(error)
        return (taken, words) if self._handed_over(deed, counts=taken) else (False, CLOSED)

    def _handed_over(self, deed: Deed, *, counts: bool) -> bool:
        """Let the session have the key that a deed picked, now that it is on record; False if it asks no longer."""
        with self._changed:
            if self._picked is None or self._picked[0] is not deed:
                return True
            (_, number, key), self._picked = self._picked, None
            self._changed.notify_all()
            if not counts:
                return True
            asked = self._view.question
            if asked is None or asked.number != number:
                return False
            self._chosen = key
        self.wake()
        return True

    def _take_at_once(self, deed: Deed) -> tuple[bool, str] | None:
        """Return what became of what an experimenter asks for, or None for what is done as it is put on record."""
        match deed:
            case Choose():
                return self._choose(deed, at_console=True)
            case Write():
                return self._write(deed)
            case Typed():
                with self._changed:
                    self._ignored += deed.keys
                return True, f"Ignored because nothing was asked: {characters.keyed(deed.keys)}."
            case Pause() | Stop():
                return self._pause(deed, port.BY_EXPERIMENTER)
            case Shown():
                return False, "Only the participant's screen says what it shows."
            case _:
                return None

    def _take_remark(self, deed: Deed, session: port.Attended | None) -> tuple[bool, str]:
        if isinstance(deed, Shown):
            return self._note_shown(deed, session)
        if session is None:
            return False, NO_SESSION
        if isinstance(deed, TakeNote):
            # Raises for what cannot go on record.
            characters.one_line(deed.text)
            about = "" if deed.trial is None else f" on trial {deed.trial}"
            return self._logged(session.remark(deed), f"Note{about}: {deed.text}")
        if isinstance(deed, Correct | Repeat):
            characters.one_line(deed.reason)
            done = self._repeat(deed, session) if isinstance(deed, Repeat) else session.remark(deed)
            return self._logged(done, f"Reason: {deed.reason}")
        raise RuntimeError(f"{deed.do} was to be done at once")

    def _logged(self, done: tuple[bool, str], what: str) -> tuple[bool, str]:
        """Show among the lines what was put on record; return what became of it."""
        if done[0]:
            self.show(f"{done[1]} {what}")
        return done

    def _take_choice(self, deed: Deed) -> tuple[bool, str] | None:
        """Take a stop, or a key for a question that is the participant's to answer; None for what is shown to them."""
        if isinstance(deed, Shown):
            return None
        if isinstance(deed, Pause):
            return self._pause(deed, port.BY_PARTICIPANT)
        if not isinstance(deed, Choose):
            return False, "The participant's screen may not ask for that."
        with self._changed:
            asked = self._view.question
            if asked is not None and asked.kind not in self._theirs.answerable:
                return False, "The participant does not answer this question at the screen."
            return self._choose(deed, at_console=False)

    def _note_shown(self, deed: Shown, session: port.Attended | None) -> tuple[bool, str]:
        """Put on record what the participant's screen shows, and since when."""
        ago_ns = monotonic_ns() - deed.t_ns
        told = next((one for one in self._prompts if one.number == deed.number), None)
        if told is None or not 0 <= ago_ns <= monotonic_ns() - self._began_ns:
            return False, "The participant's screen cannot have shown that."
        if session is not None:
            session.shown(told, ago_ns)
        return True, ""

    def _choose(self, deed: Choose, *, at_console: bool) -> tuple[bool, str]:
        with self._changed:
            asked = self._view.question
            if asked is None or self._pressed or (asked.number != deed.question and deed.key not in SAFE):
                # What the participant presses is not what the experimenter typed.
                self._ignored += TYPED.get(deed.key, deed.key) if at_console else ""
                return False, CLOSED
            if deed.key not in {choice.key for choice in asked.choices}:
                early = deed.key == ENTER and self._view.pause_until_ns is not None
                until = " until the countdown is over" if early else ""
                return False, f"{characters.quoted(deed.key)} is no key here{until}."
            self._pick(deed, asked, deed.key)
            return True, ""

    @property
    def _pressed(self) -> bool:
        """Whether the question has a key, which may not be on record yet."""
        return self._chosen is not None or self._picked is not None

    def _pick(self, deed: Deed, asked: Question, key: str) -> None:
        self._picked, self._chosen_at_ns = (deed, asked.number, key), monotonic_ns()

    def _write(self, deed: Write) -> tuple[bool, str]:
        text = characters.one_line(deed.text.strip()) if deed.text.strip() else ""
        with self._changed:
            asked = self._view.question
            if asked is None or self._pressed or asked.number != deed.question or asked.kind != "write":
                return False, "That question is no longer asked; nothing was written down."
            self._pick(deed, asked, text)
            return True, ""

    def _pause(self, deed: Pause | Stop, by: str) -> tuple[bool, str]:
        with self._changed:
            session = self._session
            if self._view.state == "ended":
                return False, "The session has ended."
            before = self._pausing
            lasts = isinstance(before, Pause) and before.minutes is not None
            # A later pause neither takes a stop back, nor a break's length.
            if isinstance(deed, Stop) or not (isinstance(before, Stop) or (lasts and deed.minutes is None)):
                self._pausing, self._paused_by = deed, by
            if before is None and by == port.BY_PARTICIPANT:
                # The reply goes to the participant's screen alone, and the session may wait for a disk.
                self.show(port.STOPPED)
            self._changed.notify_all()
        if session is not None:
            session.pause(by)
        return True, "The session pauses as soon as nothing can be felt any more."

    def stopped(self) -> None:
        self._pause(Pause(), port.BY_PARTICIPANT)
        self.wake()

    def _repeat(self, wanted: Repeat, session: port.Attended) -> tuple[bool, str]:
        with self._changed:
            asked = self._view.question
            if asked is not None and asked.kind in ("answer", "confirm") and wanted.trial == self._view.trial:
                if self._pressed:
                    return False, "A key was pressed for this question before; the trial is not done again. Ask again."
                self._repeated = wanted
                self._pick(wanted, asked, ESCAPE)
                return True, f"Trial {wanted.trial} is done again at the end of its block."
        return session.remark(wanted)

    # What the session asks, from its own.

    def attend(self, session: port.Attended | None) -> None:
        # What was asked before is on record first.
        if (why := self._recorder.submit(self._attend, session).result()) and session is not None:
            # While the devices were opened.
            session.pause(why)
        self.wake()

    def _attend(self, session: port.Attended | None) -> str:
        """Take note of a session; return why it pauses at once, or nothing."""
        with self._changed:
            if session is None and self._session is not None:
                # What was reached stays on the screen of a pause.
                self._now(state="preparing", **_standing(self._session))
            self._session, self._repeated, self._armed = session, None, None
            self._now(instruction="", again="", masked=self._view.masked and session is None)
            return self._failed or (self._paused_by if self._pausing is not None else "")

    def at(self, *, step: str, steps: Sequence[str]) -> None:
        if step != self._view.step:
            self.show(NEXT.format(step=step))
        self._now(step=step, steps=tuple(steps))

    def agree(self, *, text: str, yes: str, no: str) -> bool:
        return self._put("agree", text, _choices({port.YES: yes, port.NO: no})) == port.YES

    def write(self, *, text: str) -> str:
        self._now(trial=None, step=port.DEBRIEFING)
        return self._put("write", text, ())

    def wait(self, *, why: str, until_ns: int, clock: Clock) -> None:
        self._now(state="paused", pause_until_ns=wall_ns() + until_ns - clock.now_ns())
        try:
            self._put("break", why, (), most_s=(until_ns - clock.now_ns()) / 1e9)
        finally:
            self._now(state="preparing", pause_until_ns=None)

    def show(self, text: str) -> None:
        said = characters.plain(" ".join(text.split("\n")).strip())
        with self._changed:
            self._anchored = said if said.startswith((port.LAB_BOOK, port.NOT_ANCHORED)) else self._anchored
            self._now(lines=(*self._view.lines, said)[-LINES:])

    def familiarise(self, *, instruction: str, min_s: float, max_s: float, handled: dict[str, str]) -> str:
        counts = " A key counts how often a material was handled." if handled else ""
        begun_ns, told = wall_ns(), f"{port.lasting(min_s, max_s)}{counts}"
        self._now(state="familiarising", trial=None, instruction=instruction)
        ends = Choice(key=ENTER, words="the participant is familiar with the materials")
        try:
            if min_s > 0:
                self._now(pause_until_ns=begun_ns + int(min_s * 1e9))
                early = f"{told} Enter works once the countdown is over. {instruction}"
                if key := self._put("familiarise", early, _choices(handled), most_s=min_s):
                    return key
            self._now(pause_until_ns=begun_ns + int(max_s * 1e9))
            key = self._put("familiarise", f"{told} {instruction}", (ends, *_choices(handled)))
            return "" if key == ENTER else key
        finally:
            self._now(state="preparing", instruction="", pause_until_ns=None)

    def instruct(self, *, instruction: str) -> None:
        self.show(f"The participant is told: {instruction}")
        self._now(instruction=instruction)

    def level(self, *, level_db_a: float, limit_db_a: float, criterion: str, keys: dict[str, str]) -> str:
        text = f"Masker at {level_db_a:.0f} dB(A), at most {limit_db_a:.0f}. {criterion}"
        choices = (*_choices(keys), Choice(key=ENTER, words="keep the level"))
        self._now(masked=True)
        key = self._put("level", text, choices)
        return "" if key == ENTER else key

    def say(self, *, words: str, take: int, takes: int, why: str) -> bool:
        asked = f"Take {take} of {takes}: ask for '{words}'. Press the key, then the participant says it."
        without = Choice(key=port.WITHOUT, words="go on without the microphone")
        return self._put("say", f"{why} {asked}".strip(), (Choice(key=ENTER, words="listen now"), without)) == ENTER

    def rest(self, *, why: str) -> None:
        text = port.RESTS.partition(" Then press")[0]
        self._put("rest", f"{why} {text}".strip(), (Choice(key=ENTER, words="the foot rests on the bare panel"),))

    def place(self, *, trial: int, presented: tuple[str, ...]) -> None:
        material = port.laid_out(presented)
        self._now(trial=trial, attempt=1, lay_out=material)
        self._put("place", f"Trial {trial}. Lay out {material}.", (Choice(key=ENTER, words="it is laid out"),))

    def arm(self, *, trial: int, attempt: int, trials: int) -> bool:  # noqa: ARG002
        # A pair of virtual surfaces can be felt at once.
        state = "answering" if self._view.at_will else "armed"
        again = "The lines below say why" if self._armed == trial else ""
        waited = self._watched()
        self._armed = trial
        self._now(state=state, trial=trial, attempt=attempt, heard="", again=again)
        return waited

    def rearm(self, *, trial: int, attempt: int, reason: str) -> bool:
        self.show(f"Trial {trial}, attempt {attempt}: {reason}; nothing was played. It is armed again.")
        waited = self.arm(trial=trial, attempt=attempt, trials=0)
        self._now(again=f"{reason[:1].upper()}{reason[1:]}")
        return waited

    def waiting(self) -> None:
        self._armed = None
        self._now(state="waiting", lay_out="")

    def ask(self, *, trial: int, answers: dict[str, str], others: dict[str, str]) -> str | port.Remark:
        self._armed = None
        without = {key: words for key, words in others.items() if words == port.NO_ANSWER}
        self._now(state="answering", trial=trial, answers=_choices(answers | without, answer=True))
        if (wanted := self._take_repeated()) is not None:
            return wanted
        choices = (*_choices(answers, answer=True), *_choices(others))
        chosen = self._put("answer", "What did the participant say?", choices)
        return self._take_repeated() or chosen

    def chosen_ago_ns(self) -> int:
        return monotonic_ns() - self._chosen_at_ns

    def heard(self, *, words: str) -> None:
        self._now(heard=words)

    def confirm(self, *, key: str, meaning: str) -> bool:  # noqa: ARG002
        choices = (Choice(key=ENTER, words="confirm"), Choice(key=ESCAPE, words="choose again"))
        return self._put("confirm", meaning, choices) == ENTER

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        self.show(f"Trial {trial}: the answer is on disk: {answer or 'no answer'}.")
        self._now(state="preparing", lay_out="", heard="", instruction="")

    def debrief(self) -> None:
        at, steps = self._view.step, self._view.steps
        after = steps[steps.index(at) + 1] if at in steps[:-1] else port.DEBRIEFING
        said, does = "All trials are answered. Note what is left to note.", "end"
        if after != port.DEBRIEFING:
            said, does = f"Task {at} is done. {said} Task {after} comes next.", f"end task {at}"
        self._now(trial=None, step=after if after == port.DEBRIEFING else at)
        self._put("debrief", said, (Choice(key=ENTER, words=does),))

    def ignored(self) -> str:
        with self._changed:
            told, self._ignored = self._ignored, ""
            return told

    def goes_on(self, *, why: str) -> bool:
        # Without a session nothing had begun.
        onward = "go on with the session" if self._session is not None else "go on"
        choices = (Choice(key=ENTER, words=onward), Choice(key=STOP, words="end for today"))
        until_ns = None
        while True:
            with self._changed:
                pausing, self._pausing = self._pausing, None
            if isinstance(pausing, Stop):
                return False
            if isinstance(pausing, Pause) and pausing.minutes is not None:
                until_ns = wall_ns() + int(pausing.minutes * 60e9)
            self._now(state="paused", lay_out="", trial=None, pause_until_ns=until_ns)
            try:
                chosen = self._put("continue", why, choices)
                if chosen == ENTER and until_ns is not None and wall_ns() < until_ns:
                    chosen = self._put("continue", "The break is not over. End it now?", EARLY)
                if chosen != ESCAPE:
                    return chosen == ENTER
            except PauseAsked:
                # A pause is paused already; a break begins its countdown.
                if self._pausing is None:
                    return False
            finally:
                self._now(state="preparing", pause_until_ns=None)

    def ended(self, words: str, exit_code: int) -> None:
        """Tell that the process ends, and once more what belongs in the lab book."""
        over = Ended(words="\n".join(filter(None, (words, self._anchored))), exit_code=exit_code)
        self._now(state="ended", question=None, trial=None, lay_out="", heard="", ended=over)

    def _now(self, **changed: object) -> None:
        with self._changed:
            self._view = self._view.model_copy(update=changed)
        self.wake()

    def _watched(self) -> bool:
        """Wait for a console, and at first the screen; return whether either was away. Raises as `_put`."""
        waited = self._awaits_screen and not self._screens
        if waited:
            without = Choice(key=ENTER, words="go on without the screen")
            with self._open("agree", SCREEN_OPENS, (without,)), self._changed:
                self._changed.wait_for(lambda: self._screens or self._chosen or self._pausing or self._failed, SCREEN_S)
                self._check(attended=True)
            if not self._screens:
                self.show("The session goes on without the participant's screen, which is shown once it opens.")
        self._awaits_screen = False
        with self._changed:
            self._check(attended=True)
            while not self._consoles:
                waited = True
                self._check(attended=self._changed.wait(self._alone_s) or bool(self._consoles))
            return waited

    def _take_repeated(self) -> Repeat | None:
        with self._changed:
            wanted, self._repeated = self._repeated, None
            return wanted

    def _put(self, kind: Kind, text: str, choices: tuple[Choice, ...], *, most_s: float = inf) -> str:
        """Ask, and return the choice, or "" after `most_s`. Raises `PauseAsked` and `LinkError`."""
        ends_s = monotonic_ns() / 1e9 + most_s
        with self._open(kind, text, choices), self._changed:
            # It may have been asked for before the question was.
            self._check(attended=True)
            while self._chosen is None and (left_s := ends_s - monotonic_ns() / 1e9) > 0:
                attended = self._changed.wait(min(left_s, self._alone_s)) or bool(self._consoles) or left_s < inf
                # What was chosen counts; a pause that was asked for right after it comes at the next question.
                if not self._pressed:
                    self._check(attended=attended)
            return self._chosen or ""

    @contextmanager
    def _open(self, kind: Kind, text: str, choices: tuple[Choice, ...]) -> Iterator[None]:
        with self._changed:
            self._asked += 1
            self._chosen = None
            state = self._view.state if kind in KEEPS_STATE else "preparing"
            question = Question(number=self._asked, kind=kind, text=text, choices=choices)
            self._now(state=state, question=question)
        try:
            yield
        finally:
            self._now(question=None)

    def _check(self, *, attended: bool) -> None:
        if self._failed:
            raise LinkError(self._failed)
        if self._pausing is not None:
            raise PauseAsked(self._paused_by)
        if not attended:
            raise PauseAsked(f"nobody was at a console for {self._alone_s / 60:.0f} min")


def _choices(keys: dict[str, str], *, answer: bool = False) -> tuple[Choice, ...]:
    return tuple(Choice(key=key, words=words, answer=answer) for key, words in keys.items())


def _standing(session: port.Attended) -> dict[str, object]:
    """Return what a view says of how far a session is, and its label."""
    standing = session.standing()
    return {"standing": standing, "label": "" if standing.purpose == "STUDY" else standing.purpose}
