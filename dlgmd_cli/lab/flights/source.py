"""Rendered scenes as sources: frames go into models without a file."""

from collections.abc import Iterator, Mapping
from typing import Any

from dlgmd_cli.lab.flights.scenes import find_scene
from dlgmd_cli.lab.stimuli.base import GreyImage, OptionsT, Scene
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.source import Video


class SceneFrames:
    """The frames of a scene, (H, W) uint8; every iteration renders them again."""

    def __init__(self, scene: Scene[OptionsT], options: OptionsT) -> None:
        self._scene, self._options = scene, options

    def __iter__(self) -> Iterator[GreyImage]:
        return self._scene.frames(self._options)

    def __len__(self) -> int:
        return self._scene.n_frames(self._options)


def open_scene(name: str, flags: Mapping[str, Any] | None = None, **options: Any) -> Video:
    """Open a scene as a source, such as ``open_scene("group2", {"--size": (135, 240)})``.

    `flags` are options of the scene, see `Scene.configure`, and `options` those of `open_video`.
    Raises ParameterError if there is no such scene, or it cannot be rendered like that.
    """
    scene = find_scene(name)
    chosen = scene.configure(flags or {})
    return open_video(SceneFrames(scene, chosen), input_fps=chosen.fps, **options)
