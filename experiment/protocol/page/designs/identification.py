"""What a board's page says of identification: one material a trial, which participants name."""

from palpate.experiment.protocol.blocks import named
from palpate.experiment.protocol.page.words import DesignWords

WORDS = DesignWords(
    answers=lambda protocol: [(material.key, named(material.id)) for material in protocol.materials],
    tests={
        "equivalence": "two one-sided tests over participants of equivalence",
        "sign flips against chance": "exact test by sign flips over participants against chance",
        "sign flips between tasks": "exact test by sign flips over participants who did both tasks",
        "sign flips between materials": "exact test by sign flips over participants between pairs of materials",
        "repeated measures": "analysis of variance by repeated measures, corrected by Huynh and Feldt",
        "logit with participants": "logit in which participants differ in level, by material and by task",
        "order of tasks": "exact test over participants of the order in which they did the tasks",
        "difference of groups": "permutation test of Welch's t over participants between groups",
    },
    index="The share of right answers of a participant, for each task and material.",
)
