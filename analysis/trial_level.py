"""Study -> models of its single trials, each there or with the reason why not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from analysis.dataset import Study
from analysis.exact import NotDefined
from analysis.trial_models import TrialModel, gee, mixed
from analysis.trials import design


@dataclass(frozen=True)
class TrialLevel:
    """Models of single trials; `statements` say why one is None, `absent` why a covariate is not in them."""

    gee: TrialModel | None
    mixed: TrialModel | None
    absent: Mapping[str, str]
    left_out: int
    statements: Mapping[str, str]


def trial_level(study: Study) -> TrialLevel:
    """Both models of a study's included trials."""
    try:
        trials = design(study)
    except NotDefined as reason:
        return TrialLevel(None, None, {}, 0, {"GEE logit and mixed logit": str(reason)})
    found: dict[str, TrialModel] = {}
    said: dict[str, str] = {}
    for name, fit in (("GEE logit", gee), ("mixed logit", mixed)):
        try:
            found[name] = fit(trials)
        except NotDefined as reason:
            said[name] = str(reason)
    return TrialLevel(found.get("GEE logit"), found.get("mixed logit"), trials.absent, trials.left_out, said)
