"""What each kind of trial and each design says on a board's page: a module of its name here, with its `WORDS`."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module

from palpate.experiment.protocol.blocks import Block
from palpate.experiment.protocol.models import Protocol, Task


@dataclass(frozen=True, kw_only=True)
class KindWords:
    """What the page says of a kind of trial.

    Attributes:
        touched: what vibrates, in one or two words.
        familiar: what is felt in the familiarization of a task.
        sources: what the stimuli of a task are, by its `stimulus`.
        recorded: what is recorded of a trial, before what is of any.
        stimuli: how stimuli are made, and what starts them.
        felt: how long a task with virtual stimuli is felt.
        odd: legal but odd settings, each as its field, what it is, and what it would be as a rule.
        force: how far the force may be from its limit and from what it should be.
    """

    touched: Callable[[Protocol], str]
    familiar: Callable[[Task], str]
    sources: Mapping[str, str]
    recorded: Callable[[Protocol], str]
    stimuli: Callable[[Protocol], Iterator[Block]]
    felt: Callable[[Protocol, Task], str]
    odd: Callable[[Protocol], Iterator[tuple[str, str, str]]] = lambda _: iter(())
    force: Callable[[Protocol], str] = lambda _: ""


@dataclass(frozen=True, kw_only=True)
class DesignWords:
    """What the page says of a design.

    Attributes:
        answers: keys of answers, each with what it stands for.
        noun: what a block has each of once.
        track: what has levels of its own.
        pairs: how what is presented is put together.
        asked: what is asked about what is presented.
        ranked: in which order materials are listed.
        tests: how planned tests are called where their name does not say it.
        odd: as of a kind.
        index: what is computed of each participant's answers, where one number of them is what is analysed.
    """

    answers: Callable[[Protocol], Sequence[tuple[str | None, str]]]
    noun: str = "material"
    track: str = "each material"
    pairs: Callable[[Protocol], str] = lambda _: ""
    asked: Callable[[Protocol], str] = lambda _: ""
    ranked: Callable[[Protocol], str] = lambda _: ""
    tests: Mapping[str, str] = field(default_factory=dict)
    odd: Callable[[Protocol], Iterator[tuple[str, str, str]]] = lambda _: iter(())
    index: str = ""


def kind_words(task: Task) -> KindWords:
    """Return what the page says of the kind of a task."""
    words: KindWords = import_module(f"{__package__}.kinds.{task.kind}").WORDS
    return words


def design_words(task: Task) -> DesignWords:
    """Return what the page says of the design of a task."""
    words: DesignWords = import_module(f"{__package__}.designs.{task.design}").WORDS
    return words
