"""The cascade of an LGMD2 and an LGMD1, Li et al. 2023."""

from dlgmd_cli.models.published.lgmd1_lgmd2 import Lgmd1Lgmd2


class Lgmd2Lgmd1(Lgmd1Lgmd2):
    """The other cascade of [Li2023]: an LGMD1 sees the changes in the layer S of an LGMD2.

    The equations and parameters are those of `Lgmd1Lgmd2`, but the LGMD2 comes first: w of ON is
    0.4 w+ in the first layer S and w- in the second. The authors and the benchmark differ as there.
    """

    are_lgmd2 = True, False
