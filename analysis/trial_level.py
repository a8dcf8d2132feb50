"""Study -> models of its single trials, each there or with the reason why not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from analysis.exact import NotDefined
from analysis.study import Study
from analysis.trial_models import TrialModel, gee, mixed
from analysis.trials import design


@dataclass(frozen=True)
class TrialLevel:
    """Models of single trials; `statements` say why one is None, the rest is that of `analysis.trials.Design`."""

    gee: TrialModel | None
    mixed: TrialModel | None
    absent: Mapping[str, str]
    left_out: Mapping[str, int]
    gone: tuple[str, ...]
    statements: Mapping[str, str]


def trial_level(study: Study) -> TrialLevel:
    """Both models of a study's included trials."""
    try:
        trials = design(study)
    except NotDefined as reason:
        return TrialLevel(None, None, {}, {}, (), {"GEE logit and mixed logit": str(reason)})
    found: dict[str, TrialModel] = {}
    said: dict[str, str] = {}
    for name, fit in (("GEE logit", gee), ("mixed logit", mixed)):
        try:
            found[name] = fit(trials)
        except NotDefined as reason:
            said[name] = str(reason)
    models = found.get("GEE logit"), found.get("mixed logit")
    return TrialLevel(*models, trials.absent, trials.left_out, trials.gone, said)
