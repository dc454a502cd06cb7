"""The D-LGMD with ON and OFF pathways, as proposed in the last section of [Zhao2023]."""

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.receptors import OFF, ON
from dlgmd_cli.parameters.presets import OnOffParameters


class OnOffDLGMD(DLGMD):
    """D-LGMD in which brightening and darkening cells do not inhibit each other.

    ::

        P_on(t) = max(L(t) - L(t-1), 0),  P_off(t) = max(L(t-1) - L(t), 0)
        S_on(t), S_off(t)  from P_on and P_off, each by [Zhao2023] Eqs. (2) to (7)
        S(t) = S_on(t) + S_off(t)

    Everything else is as in the D-LGMD: P = P_on + P_off, and G, its threshold and K follow from S
    and P by Eqs. (8) to (13).

    Parameters
    ----------
    params : OnOffParameters, optional
        The published defaults unless given.
    """

    params_class = OnOffParameters
    polarities = (ON, OFF)
    params: OnOffParameters
