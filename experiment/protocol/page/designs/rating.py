"""What a board's page says of rating: one material a trial, and participants say how much of a quality it has."""

from palpate.experiment.protocol.blocks import named, number
from palpate.experiment.protocol.designs.rating import Rating, words
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page.words import DesignWords


def _question_words(protocol: Protocol) -> str:
    rating = protocol.table(Rating)
    told = "."
    if rating.standard is not None and rating.modulus is not None:
        told = f"; they are told that {named(rating.standard)} rates {number(rating.modulus)}."
    return f"Participants rate how much {named(rating.quality)} each material has on this scale{told}"


def _ranked(protocol: Protocol) -> str:
    rating = protocol.table(Rating)
    if not rating.magnitudes:
        return ""
    stated = ", ".join(f"{named(one.material)} {number(one.value)}" for one in rating.magnitudes)
    return f"Ratings may follow a power function of the physical magnitude: {stated} {rating.unit}."


WORDS = DesignWords(
    answers=lambda protocol: [(place.key, words(place)) for place in protocol.table(Rating).scale],
    asked=_question_words,
    ranked=_ranked,
    tests={
        "mean ratings": "repeated-measures analysis of variance of mean ratings with the Huynh-Feldt correction",
        "agreement of ratings": "intraclass correlations of mean ratings",
        "power law": "power function of the physical magnitude, fitted to each participant's ratings",
    },
)
