"""Psi: as QUEST+, for the entropy of threshold and spread alone; lapses are a nuisance, summed over beforehand.

With one lapse it is the method of Kontsevich and Tyler (1999), and QUEST+ as well; with several, psi-marginal (Prins
2013), which spends no trial on what only tells how often a participant lapses.

L. L. Kontsevich, C. W. Tyler: Bayesian adaptive estimation of psychometric slope and threshold. Vision Res. 39, 1999.
N. Prins: The psi-marginal adaptive method. J. Vision 13(7):3, 2013.
"""

from functools import partial

from palpate.experiment.study.levels.quest_plus import QuestPlus

method = partial(QuestPlus, beside_lapses=True)
