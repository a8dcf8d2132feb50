"""What a board's page says of rating: one material a trial, and participants say how much of a quality it has."""

from palpate.experiment.protocol.blocks import named, number
from palpate.experiment.protocol.designs.rating import Rating, words
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page.words import DesignWords


def _question_words(protocol: Protocol) -> str:
    rating = protocol.table(Rating)
    told = "."
    if rating.standard is not None and rating.modulus is not None:
        told = f"; they are told that {named(rating.standard)} has a rating of {number(rating.modulus)}."
    return f"Participants say how much {named(rating.quality)} each material has, on this scale{told}"


def _ranked(protocol: Protocol) -> str:
    rating = protocol.table(Rating)
    if not rating.magnitudes:
        return ""
    stated = ", ".join(f"{named(one.material)} {number(one.value)}" for one in rating.magnitudes)
    return f"Ratings may be a power of what is physical, {stated} {rating.unit}."


WORDS = DesignWords(
    answers=lambda protocol: [(place.key, words(place)) for place in protocol.table(Rating).scale],
    asked=_question_words,
    ranked=_ranked,
    tests={
        "mean ratings": "analysis of variance of mean ratings by repeated measures, corrected by Huynh and Feldt",
        "agreement of ratings": "intraclass correlations of mean ratings",
        "power law": "ratings as a power of what is physical, fitted to each participant",
    },
)
