"""A session's desk whose console and participant's screen are processes of their own, at the other end of a link.

The session waits here for keys from the link's thread; another thread waits for disks. A key counts only for the
question on the screen when it was pressed. Without a console nothing new is armed, and then the session pauses.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from math import inf

from palpate.experiment.apparatus import host
from palpate.experiment.clock import monotonic_ns, wall_ns
from palpate.experiment.desk import messages, prompts, questions
from palpate.experiment.desk.link import wire
from palpate.experiment.desk.link.standing import standing
from palpate.experiment.desk.link.wire import Asked, Choose, Deed, Hello, Pause, Stop, View
from palpate.experiment.desk.messages import ENTER, ESCAPE
from palpate.experiment.desk.questions import Arm, Attended, Notice, Pressed, Question, Reply
from palpate.experiment.errors import LinkError, PalpateError, PauseAsked
from palpate.experiment.settings import characters

ALONE_S = 600.0
"""After so long without a console the session pauses, s."""

SCREEN_S = 60.0
"""Nothing is armed for so long, s, while the participant's screen opens; PsychoPy takes some ten to load."""

KEEPS_STATE = ("play", "answer", "confirm", "familiarise", "break", "continue")
"""Questions that belong to a state of the session; while any other is asked, and after it, what comes is prepared."""

PATIENCE_NS = 300_000_000
"""After so long without anything to show the participant is asked to wait, ns."""

PROMPTS = 20
"""So many prompts are remembered, for the participant's screen to say when it showed them."""

SCREEN_OPENS = questions.Asking(
    "agree",
    "The participant's screen is opening, which takes a few seconds. The trial will be armed once it is open.",
    questions.keyed({ENTER: "continue without the screen"}),
)

END_BREAK = questions.Asking(
    "continue",
    "The break is not over. End it now?",
    questions.keyed({ENTER: "end the break", ESCAPE: "continue the break"}),
)
"""A key that is leaned on is one press, and no answer to this."""

NOT_THEIRS: dict[messages.By, str] = {
    "participant": "The participant cannot answer this question on the screen.",
    "buttons": "The participant cannot answer this question with the buttons.",
    "experimenter": "Only the participant can answer this question.",
}
"""What is said of a choice that is another's."""

BUTTONS = "the participant's buttons"
"""Who asks for something with them, as it goes on record."""

EARLY = "The participant pressed {} before the question. This press does not count."

NEXT = "── Task {step} ──"
"""The line between what was told of one task and what is told of the next."""

UNWRITABLE = "The text {}, which cannot be recorded; write it without that character."

NO_SESSION = (
    "No session is open, so nothing can be recorded now. Write your note on paper, and enter it here during the next "
    "session."
)


class LinkedConsole:
    """Implements `Console` and the link's `SessionEnd`."""

    def __init__(
        self, view: View, *, answers: Mapping[str, str] | None = None, screen: bool = False, alone_s: float = ALONE_S
    ) -> None:
        """Begin with `view`; `answers` are the participant's, in words by their keys, allowed in any trial."""
        self._view = view
        self._alone_s = alone_s
        self._changed = threading.Condition()
        # What waits for the disk, one after the other, so that the link's thread does not.
        self._recorder: Executor = ThreadPoolExecutor(1, "recorder", initializer=host.favour)
        self._session: Attended | None = None
        self._asked = 0
        self._chosen: str | None = None
        self._chosen_at_ns = self._opened_ns = 0
        self._deed: Deed | None = None
        self._by: messages.By = "experimenter"
        self._picked: tuple[Deed, int, str] | None = None
        self._repeated: messages.Repeat | None = None
        self._consoles = 0
        self._answers = answers or {}
        self._screen = self._awaits_screen = screen
        self._screens = 0
        self._prompts = [messages.Prompt()]
        # No screen showed anything of a session before its desk began; another clock's reading may be a second off.
        self._began_ns = monotonic_ns() - 10**9
        self._armed: int | None = None
        self._waits_ns: int | None = None
        self._pausing: Pause | Stop | None = None
        self._paused_by = questions.BY_EXPERIMENTER
        self._failed = ""
        self._ignored = ""
        self._anchored = ""
        self.wake: Callable[[], None] = lambda: None
        """Called when there is something new to tell."""

    # What the link asks, from its thread.

    def message(self, role: str) -> messages.Message:
        with self._changed:
            view, session = self._view, self._session
        if session is not None:
            measured = session.gauges()
            gauges = self._with_screen(measured) if measured is not None else None
            view = view.model_copy(update={"gauges": gauges, **_standing(session)})
        if role != "console":
            return self._prompt(view)
        asked = view.question
        theirs = asked and asked.model_copy(update={"choices": self._may(asked, "experimenter")})
        return view.model_copy(update={"question": theirs})

    def _may(self, asked: Asked, who: messages.By) -> tuple[messages.Choice, ...]:
        """Return what somebody may choose; without a screen the experimenter keys what the participant says of the
        masker, and never an answer that is the participant's own.
        """
        lends = who == "experimenter" and not self._screens
        return tuple(
            one
            for one in asked.choices
            if one.by == who
            or (one.by == "either" and who != "buttons")
            or (lends and one.by == "participant" and not one.answer)
        )

    def _with_screen(self, gauges: messages.Gauges) -> messages.Gauges:
        if not (self._screen or self._screens):
            return gauges
        there = self._screens > 0
        words = "connected" if there else "not connected; `palpate screen` opens it"
        return gauges.model_copy(
            update={"lamps": (*gauges.lamps, messages.Lamp(name="screen", good=there, words=words))}
        )

    def _prompt(self, view: View) -> messages.Prompt:
        """Return what the participant's screen shows, with a number that changes when its look does."""
        last = self._prompts[-1]
        new = prompts.prompt(view, self._answers)
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
                words = f"Another console was opened; {consoles} are open. Whichever console answers first counts."
                self.tell(Notice(words))
            elif 1 <= consoles < self._consoles:
                self.tell(Notice("Another console was closed."))
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
        return self._take(hello.by, deed, "experimenter" if hello.role == "console" else "participant")

    def _take(self, by: str, deed: Deed, who: messages.By) -> tuple[bool, str] | Future[tuple[bool, str]]:
        try:
            done = self._take_at_once(deed, who)
        except ValueError as error:
            done = False, UNWRITABLE.format(error)
        recorded = self._recorder.submit(self._record, by, deed, done)
        # These alone count before they are on record.
        return done if done is not None and isinstance(deed, Pause | Stop) else recorded

    def _record(self, by: str, deed: Deed, done: tuple[bool, str] | None) -> tuple[bool, str]:
        """Do what only a disk that answers allows; return whether the deed was taken, and the reply."""
        session = self._session
        try:
            taken, words = done or self._take_remark(deed, session)
        except ValueError as error:
            taken, words = False, UNWRITABLE.format(error)
        except PalpateError as error:
            return False, error.sentence()
        # What was typed and what was shown have entries of their own.
        if session is not None and not (taken and isinstance(deed, wire.Typed | wire.Shown)):
            # The words of a remark stand in its own entry.
            timed = {"t_ns", "device_us", "error_s"} if isinstance(deed, Choose) else set()
            own = {"do", "text", "reason", "done"} | timed
            facts = deed.model_dump(exclude=own, exclude_none=True)
            command = " ".join([deed.do, *map(str, facts.values())])
            try:
                session.commanded(by=by, command=command, taken=taken, words=words)
            except PalpateError as error:
                taken, words = False, error.sentence()
                if isinstance(deed, Choose):
                    # Nothing can be answered any more: the session pauses, and meets the fault as it ends.
                    self._pause(Pause(), words)
        return (taken, words) if self._handed_over(deed, counts=taken) else (False, wire.CLOSED)

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

    def _take_at_once(self, deed: Deed, who: messages.By) -> tuple[bool, str] | None:
        """Return what became of what somebody asks for, or None for what is done as it is put on record."""
        match deed:
            case Choose():
                return self._choose(deed, who)
            case Pause() if who == "participant":
                return self._pause(deed, questions.BY_PARTICIPANT)
            case wire.Shown():
                return None if who == "participant" else (False, "Only the participant's screen reports what it shows.")
            case _ if who == "participant":
                return False, "The participant's screen cannot request that."
            case wire.Write():
                return self._write(deed)
            case wire.Typed():
                with self._changed:
                    self._ignored += deed.keys
                return True, f"Ignored because there was no question: {characters.keyed(deed.keys)}."
            case Pause() | Stop():
                return self._pause(deed, questions.BY_EXPERIMENTER)
            case _:
                return None

    def _take_remark(self, deed: Deed, session: Attended | None) -> tuple[bool, str]:
        if isinstance(deed, wire.Shown):
            return self._note_shown(deed, session)
        if session is None:
            return False, NO_SESSION
        if isinstance(deed, messages.Reveal):
            return session.remark(deed)
        if isinstance(deed, messages.TakeNote):
            # Raises for what cannot go on record.
            characters.one_line(deed.text)
            about = "" if deed.trial is None else f" on trial {deed.trial}"
            return self._logged(session.remark(deed), f"Note{about}: {deed.text}")
        if isinstance(deed, messages.TellIncident):
            characters.one_line(deed.text + deed.done)
            return self._logged(session.remark(deed), f"{deed.text} Done: {deed.done}")
        if isinstance(deed, messages.Correct | messages.Repeat):
            characters.one_line(deed.reason)
            done = self._repeat(deed, session) if isinstance(deed, messages.Repeat) else session.remark(deed)
            return self._logged(done, f"Reason: {deed.reason}")
        raise RuntimeError(f"{deed.do} was to be done at once")

    def _logged(self, done: tuple[bool, str], what: str) -> tuple[bool, str]:
        """Show among the lines what was put on record; return what became of it."""
        if done[0]:
            self.tell(Notice(f"{done[1]} {what}"))
        return done

    def _note_shown(self, deed: wire.Shown, session: Attended | None) -> tuple[bool, str]:
        """Put on record what the participant's screen shows, and since when."""
        ago_ns = monotonic_ns() - deed.t_ns
        told = next((one for one in self._prompts if one.number == deed.number), None)
        if told is None or not 0 <= ago_ns <= monotonic_ns() - self._began_ns:
            return False, "The participant's screen cannot have shown that."
        if session is not None:
            session.shown(told, ago_ns)
        return True, ""

    def _choose(self, deed: Choose, who: messages.By) -> tuple[bool, str]:
        with self._changed:
            asked = self._view.question
            if asked is None or self._pressed or (asked.number != deed.question and deed.key not in wire.SAFE):
                # What the participant presses is not what the experimenter typed.
                self._ignored += wire.TYPED.get(deed.key, deed.key) if who == "experimenter" else ""
                return False, wire.CLOSED
            if deed.key not in {choice.key for choice in asked.choices}:
                early = deed.key == ENTER and self._view.pause_until_ns is not None
                until = " until the countdown is over" if early else ""
                return False, f"{characters.quoted(deed.key)} is not a key here{until}."
            if deed.key not in {choice.key for choice in self._may(asked, who)}:
                return False, NOT_THEIRS[who]
            at_ns = min(max(deed.t_ns, self._opened_ns), monotonic_ns())
            if at_ns != deed.t_ns and deed.key not in wire.SAFE:
                return False, "The time of that key press is not possible."
            self._pick(deed, asked, deed.key, at_ns)
            self._by = who
            return True, ""

    @property
    def _pressed(self) -> bool:
        """Whether the question has a key, which may not be on record yet."""
        return self._chosen is not None or self._picked is not None

    def _pick(self, deed: Deed, asked: Asked, key: str, at_ns: int) -> None:
        self._picked, self._chosen_at_ns = (deed, asked.number, key), at_ns
        self._deed, self._by = deed, "experimenter"

    def _write(self, deed: wire.Write) -> tuple[bool, str]:
        text = characters.one_line(deed.text.strip()) if deed.text.strip() else ""
        with self._changed:
            asked = self._view.question
            if asked is None or self._pressed or asked.number != deed.question or asked.kind != "write":
                return False, "That question is closed; nothing was recorded."
            self._pick(deed, asked, text, monotonic_ns())
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
            if before is None and by == questions.BY_PARTICIPANT:
                # The reply goes to the participant's screen alone, and the session may wait for a disk.
                self.tell(Notice(questions.STOPPED))
            self._changed.notify_all()
        if session is not None:
            session.pause(by)
        return True, "The session will pause as soon as nothing can be felt."

    def _repeat(self, wanted: messages.Repeat, session: Attended) -> tuple[bool, str]:
        with self._changed:
            asked = self._view.question
            if asked is not None and asked.kind in ("answer", "confirm") and wanted.trial == self._view.trial:
                if self._pressed:
                    return False, "This question was just answered, so the trial is not repeated. Try again."
                self._repeated = wanted
                self._pick(wanted, asked, ESCAPE, monotonic_ns())
                return True, f"Trial {wanted.trial} will be repeated at the end of its block."
        done = session.remark(wanted)
        with self._changed:
            asked = self._view.question
            if done[0] and asked is not None and asked.kind == "play" and not self._pressed:
                self._pick(wanted, asked, ESCAPE, monotonic_ns())
        return done

    # What the session asks, from its own.

    def attend(self, session: Attended | None) -> None:
        # What was asked before is on record first.
        if (why := self._recorder.submit(self._attend, session).result()) and session is not None:
            # While the devices were opened.
            session.pause(why)
        self.wake()

    def _attend(self, session: Attended | None) -> str:
        """Take note of a session; return why it pauses at once, or nothing."""
        with self._changed:
            if session is None and self._session is not None:
                # What was reached stays on the screen of a pause.
                self._now(state="preparing", **_standing(self._session))
            self._session, self._repeated, self._armed = session, None, None
            silent = session is None or session.gauges() is None
            self._now(instruction="", pictures=(), again="", masked=self._view.masked and silent)
            return self._failed or (self._paused_by if self._pausing is not None else "")

    def tell(self, event: questions.Event) -> None:
        match event:
            case Notice(text=text, again=again):
                said = characters.plain(" ".join(text.split("\n")).strip())
                with self._changed:
                    self._anchored = said if again else self._anchored
                    self._now(lines=(*self._view.lines, said)[-wire.LINES :])
            case questions.At(step=step, steps=steps):
                if step != self._view.step:
                    self.tell(Notice(NEXT.format(step=step)))
                self._now(step=step, steps=tuple(steps))
            case questions.Instructed(instruction=instruction, asks=asks, pictures=pictures):
                self.tell(Notice(f"Instruction for the participant: {event.words}"))
                self._now(instruction=instruction, asks=asks, pictures=pictures)
            case questions.Playing(place=place):
                self._now(interval=place)
            case questions.Played():
                self._now(interval=None)
            case questions.Silent():
                self._armed = None
                self._now(state="waiting", lay_out="")
            case questions.Proposed(words=words):
                self._now(heard=words)
            case questions.Answered():
                self.tell(Notice(event.text))
                self._now(state="preparing", lay_out="", heard="", instruction="")
            case questions.Stopped():
                self._pause(Pause(), questions.BY_PARTICIPANT)
                self.wake()
            case Pressed():
                self._follow(event)

    def _follow(self, press: Pressed) -> None:
        """Have a press answer the question that was asked before it, if it may."""
        t_ns = monotonic_ns() - press.ago_ns
        with self._changed:
            asked = self._view.question
            early = asked is None or self._pressed or t_ns < self._opened_ns
            number = 0 if early or asked is None else asked.number
            deed = Choose(question=number, key=press.key, t_ns=t_ns, device_us=press.device_us, error_s=press.error_s)
            self._take(BUTTONS, deed, press.by)
        if early:
            self.tell(Notice(EARLY.format(characters.quoted(press.key))))

    def ask(self, question: Question | Arm) -> Reply:
        match question:
            case Arm():
                return Reply(waited=self._arm(question))
            case questions.GoOn():
                return self._go_on(question)
            case questions.TrialAnswer():
                return self._answer(question)
            case questions.Familiarise():
                return self._familiarise(question)
            case questions.Break(left_s=left_s):
                self._now(state="paused", pause_until_ns=wall_ns() + int(left_s * 1e9))
                try:
                    return self._reply(question, most_s=left_s)
                finally:
                    self._now(state="preparing", pause_until_ns=None)
            case questions.Report():
                self._now(trial=None, step=questions.DEBRIEFING)
            case questions.Level():
                self._now(masked=True)
            case questions.Place(trial=trial, objects=objects):
                self._now(trial=trial, attempt=1, lay_out=objects)
            case questions.Debrief():
                at, steps = self._view.step, self._view.steps
                after = steps[steps.index(at) + 1] if at in steps[:-1] else questions.DEBRIEFING
                self._now(trial=None, step=after if after == questions.DEBRIEFING else at)
                question = questions.Debrief(at, after)
        return self._reply(question)

    def _familiarise(self, question: questions.Familiarise) -> Reply:
        begun_ns, reply = wall_ns(), Reply()
        self._now(state="familiarising", trial=None, instruction=question.instruction)
        try:
            if question.min_s > 0:
                self._now(pause_until_ns=begun_ns + int(question.min_s * 1e9))
                reply = self._reply(replace(question, early=True), most_s=question.min_s)
            if not reply.key:
                self._now(pause_until_ns=begun_ns + int(question.max_s * 1e9))
                reply = self._reply(question)
            return reply
        finally:
            self._now(pause_until_ns=None)
            if not (question.plays and (reply.key or question.unfelt)):
                self._now(state="preparing", instruction="")

    def _arm(self, wanted: Arm) -> bool:
        """Show that an attempt is armed, once somebody is there; return whether anybody was waited for."""
        if wanted.broken_off:
            self.tell(Notice(wanted.text))
        # A pair of virtual surfaces can be felt at once.
        state = "answering" if self._view.at_will else "armed"
        again = "The reason is below" if self._armed == wanted.trial else ""
        waited = self._watched()
        self._armed = wanted.trial
        if wanted.broken_off:
            again = f"{wanted.broken_off[:1].upper()}{wanted.broken_off[1:]}"
        self._now(
            state=state,
            trial=wanted.trial,
            attempt=wanted.attempt,
            training=wanted.trials if wanted.training else None,
            may=wanted.may,
            heard="",
            again=again,
            interval=None,
        )
        return waited

    def _answer(self, question: questions.TrialAnswer) -> Reply:
        self._armed = None
        answers = questions.keyed({**question.answers, question.none: questions.NO_ANSWER}, answer=True)
        self._now(state="answering", trial=question.trial, answers=answers)
        if (wanted := self._take_repeated()) is not None:
            return Reply(remark=wanted)
        reply = self._reply(question)
        if reply.key in (*question.answers, question.none):
            self._now(may="")
        return replace(reply, remark=self._take_repeated())

    def ignored(self) -> str:
        with self._changed:
            told, self._ignored = self._ignored, ""
            return told

    def _go_on(self, question: questions.GoOn) -> Reply:
        until_ns = None
        while True:
            with self._changed:
                pausing, self._pausing = self._pausing, None
            if isinstance(pausing, Stop):
                return Reply(questions.STOP)
            if isinstance(pausing, Pause) and pausing.minutes is not None:
                until_ns = wall_ns() + int(pausing.minutes * 60e9)
            self._now(state="paused", lay_out="", trial=None, pause_until_ns=until_ns)
            try:
                reply = self._reply(question)
                if reply.key == ENTER and until_ns is not None and wall_ns() < until_ns:
                    reply = self._reply(END_BREAK)
                if reply.key != ESCAPE:
                    return reply
            except PauseAsked:
                # A pause is paused already; a break begins its countdown.
                if self._pausing is None:
                    return Reply(questions.STOP)
            finally:
                self._now(state="preparing", pause_until_ns=None)

    def ended(self, words: str, exit_code: int) -> None:
        """Tell that the process ends, and once more what belongs in the lab book."""
        over = wire.Ended(words="\n".join(filter(None, (words, self._anchored))), exit_code=exit_code)
        self._now(state="ended", question=None, trial=None, lay_out="", heard="", ended=over)

    def _now(self, **changed: object) -> None:
        with self._changed:
            self._view = self._view.model_copy(update=changed)
        self.wake()

    def _watched(self) -> bool:
        """Wait for a console, and at first the screen; return whether either was away. Raises as `_reply`."""
        waited = self._awaits_screen and not self._screens
        if waited:
            with self._open(SCREEN_OPENS), self._changed:
                self._changed.wait_for(lambda: self._screens or self._chosen or self._pausing or self._failed, SCREEN_S)
                self._check(attended=True)
            if not self._screens:
                self.tell(
                    Notice(
                        "The session continues without the participant's screen. The screen will be used once it opens."
                    )
                )
        self._awaits_screen = False
        with self._changed:
            self._check(attended=True)
            while not self._consoles:
                waited = True
                self._check(attended=self._changed.wait(self._alone_s) or bool(self._consoles))
            return waited

    def _take_repeated(self) -> messages.Repeat | None:
        with self._changed:
            wanted, self._repeated = self._repeated, None
            return wanted

    def _reply(self, question: Question, *, most_s: float = inf) -> Reply:
        """Ask, and return the reply, without a key after `most_s`. Raises `PauseAsked` and `LinkError`."""
        ends_s = monotonic_ns() / 1e9 + most_s
        with self._open(question), self._changed:
            # It may have been asked for before the question was.
            self._check(attended=True)
            while self._chosen is None and (left_s := ends_s - monotonic_ns() / 1e9) > 0:
                attended = self._changed.wait(min(left_s, self._alone_s)) or bool(self._consoles) or left_s < inf
                # What was chosen counts; a pause that was asked for right after it comes at the next question.
                if not self._pressed:
                    self._check(attended=attended)
            chosen = self._chosen or ""
        if question.kind == "write":
            return Reply(text=chosen)
        reply = Reply(chosen, ago_ns=monotonic_ns() - self._chosen_at_ns, by=self._by)
        made = self._deed
        return replace(reply, device_us=made.device_us, error_s=made.error_s) if isinstance(made, Choose) else reply

    @contextmanager
    def _open(self, question: Question) -> Iterator[None]:
        with self._changed:
            self._asked += 1
            self._chosen, self._opened_ns = None, monotonic_ns()
            state = self._view.state if question.kind in KEEPS_STATE else "preparing"
            asked = Asked(
                number=self._asked,
                kind=question.kind,
                text=question.text,
                choices=question.choices,
                confirms=self._asked - 1 if question.kind == "confirm" else None,
            )
            self._now(state=state, question=asked)
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
            raise PauseAsked(f"no console was open for {self._alone_s / 60:.0f} min")


def _standing(session: Attended) -> dict[str, object]:
    """Return what a view says of how far a session is, and its label."""
    done = session.done()
    return {"standing": standing(done), "label": "" if done.header.purpose == "STUDY" else done.header.purpose}
