"""A rule beside those of the package: a spike, or a short time to contact."""

import numpy as np

from dlgmd_cli.models.rules import Rule
from dlgmd_cli.parameters.keys import changed


class Either(Rule, name="either"):
    """An alarm while the potential reaches `t_mp`, or the time to contact is `ttc_alarm` or less.

    It compares the greater one of both, each by its threshold, with 1.
    """

    quantity, calibrated = "MP or the time to contact, whichever is nearer to its threshold", "both"

    @property
    def thresholds(self):
        return {"level": self.params.t_mp, "ttc_s": self.params.ttc_alarm}

    @property
    def text(self):
        return f"either: {self.line_text('level')}, or {self.line_text('ttc_s')}"

    def value(self, seen):
        return np.fmax(seen.level / self.params.t_mp, self.params.ttc_alarm / seen.ttc_s)

    def chosen(self, strength, n_in_a_row):
        return {"threshold": strength}

    def tuned(self, strength, n_in_a_row):
        t_mp, ttc_alarm = self.params.t_mp * strength, self.params.ttc_alarm / strength
        return changed(self.params, t_mp=min(t_mp, 1.0), ttc_alarm=ttc_alarm)
