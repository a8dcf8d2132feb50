"""What a board's page says of identification: one material a trial, which participants name."""

from palpate.experiment.protocol.blocks import named
from palpate.experiment.protocol.page.words import DesignWords

WORDS = DesignWords(answers=lambda protocol: [(material.key, named(material.id)) for material in protocol.materials])
