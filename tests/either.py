"""A rule beside those of the package: a spike, or a short time to contact."""

import numpy as np

from dlgmd_cli.models.rules import Rule
from dlgmd_cli.parameters.keys import changed


class Either(Rule, name="either"):
    """An alarm while the potential reaches `t_mp`, or the time to contact is `ttc_alarm` or less.

    It compares the greater one of both, each by its threshold, with 1.
    """

    quantity, calibrated = "MP or the time to contact, whichever is nearer to its threshold", "both"

    def value(self, row):
        return np.fmax(row.level / self.params.t_mp, self.params.ttc_alarm / row.ttc_s)

    def chosen(self, strength, n_in_a_row):
        return {"threshold": strength}

    def tuned(self, strength, n_in_a_row):
        t_mp, ttc_alarm = self.params.t_mp * strength, self.params.ttc_alarm / strength
        return changed(self.params, t_mp=min(t_mp, 1.0), ttc_alarm=ttc_alarm)
