"""What one model says over time: membrane potential, attenuation, spikes. Data in, Figure out."""

from matplotlib.figure import Figure

from dlgmd_cli.plots.overlays import overlay_attenuation, overlay_mp, overlay_spikes
from dlgmd_cli.plots.style import Width
from dlgmd_cli.results.annotations import Annotations
from dlgmd_cli.results.tables import Result

_NO_ANNOTATIONS = Annotations()


def plot_mp(
    result: Result, annotations: Annotations = _NO_ANNOTATIONS, *, width: Width = "one"
) -> Figure:
    """Normalised membrane potential with its threshold, spikes and collisions.

    Parameters
    ----------
    result : Result
        At least one frame; frames without a level leave a gap. Of a long result the line is the
        highest level of every column of pixels, over a band down to the lowest.
    annotations : Annotations
        What is marked beside, by frame.
    width : "one" or "two"
        Columns of the paper that the figure takes.
    """
    return overlay_mp({"MP": result}, annotations, width=width)


def plot_attenuation(
    result: Result, annotations: Annotations = _NO_ANNOTATIONS, *, width: Width = "one"
) -> Figure:
    """Attenuation 10 lg(ΣS/ΣP) in dB: a gap where undefined, a mark where next to nothing passes.

    Parameters
    ----------
    result, annotations, width
        As `plot_mp` takes them.
    """
    return overlay_attenuation({"attenuation": result}, annotations, width=width)


def plot_spikes(
    result: Result, annotations: Annotations = _NO_ANNOTATIONS, *, width: Width = "one"
) -> Figure:
    """Raster of spikes and collisions above the level that caused them.

    Parameters
    ----------
    result, annotations, width
        As `plot_mp` takes them. Spikes too near each other to be told apart are one bar.
    """
    return overlay_spikes({"MP": result}, annotations, width=width)


# Every picture of a result: file name without suffix -> what draws it.
PLOTS = {"mp": plot_mp, "attenuation": plot_attenuation, "spikes": plot_spikes}
