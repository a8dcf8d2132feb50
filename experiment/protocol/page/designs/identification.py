"""What a board's page says of identification: one material a trial, which participants name."""

from palpate.experiment.protocol.blocks import named
from palpate.experiment.protocol.page.words import DesignWords

WORDS = DesignWords(
    answers=lambda protocol: [(material.key, named(material.id)) for material in protocol.materials],
    tests={
        "equivalence": "two one-sided tests of equivalence across participants",
        "sign flips against chance": "exact sign-flip test against chance across participants",
        "sign flips between tasks": "exact sign-flip test between tasks across participants who did both",
        "sign flips between materials": "exact sign-flip test between pairs of materials across participants",
        "repeated measures": "repeated-measures analysis of variance with the Huynh-Feldt correction",
        "logit with participants": "logit model by material and task, in which participants vary in overall level",
        "order of tasks": "exact test of task order across participants",
        "difference of groups": "permutation test of Welch's t between groups of participants",
    },
    index="Each participant's proportion correct, for each task and material.",
)
