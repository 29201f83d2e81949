"""What the commands call: a result on a page, or a training."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread

from gsjax.io.scenes import load_scene
from gsjax.settings import Settings
from gsjax.training.loop import Progress
from gsjax.viewer.page import HOST, PORT, Page, check_port
from gsjax.viewer.snapshots import Snapshots
from gsjax.viewer.viewed_scene import open_viewed_scene, view_data_set

SHARE = 0.03  # Of a training's time, what its page may take.


def view(source: str | Path, *, mesh: str | Path | None = None, host: str = HOST, port: int = PORT) -> None:
    """Serve a page that shows a result, until it is interrupted.

    Args:
        source: A run folder; a file of Gaussians (.ply, .compressed.ply, .sog, .spz); or a mesh (.ply, .obj, .glb).
        mesh: A mesh to show over Gaussians; None: `mesh.ply` of a run that has one.
        host: Address to listen on; 127.0.0.1 is this machine alone.
        port: 0 takes a free one.

    Raises:
        InputError: The source or the mesh cannot be read, or the port is in use.
    """
    check_port(host, port)
    viewed = open_viewed_scene(source, mesh=mesh, notify=_tell)
    with suppress(KeyboardInterrupt), Page(viewed, host=host, port=port) as page:
        _tell(f"{page.address} shows {viewed.name}; Ctrl-C ends it")
        page.work()


@contextmanager
def watch(
    scene: str | Path, settings: Settings, *, host: str = HOST, port: int = PORT
) -> Iterator[Callable[[Progress], None]]:
    """Serve a page that shows a training while the context lasts.

    Its Gaussians are copied every few seconds while a browser looks. What the page takes, compilation and drawing
    included, is kept to `SHARE` of the time since it opened.

    Args:
        scene: The data set.
        settings: Of the run.
        host: Address to listen on.
        port: 0 takes a free one.

    Yields:
        The observer of every step, see `gsjax.pipeline.train`.

    Raises:
        InputError: The data set cannot be read, or the port is in use.
    """
    check_port(host, port)
    loaded = load_scene(
        scene,
        downscale=settings.photos.downscale or 1,
        folder_masks=settings.photos.masks,
        images=settings.photos.images,
        hold_out=settings.photos.hold_out,
        photos=settings.photos.subset,
    )
    viewed = view_data_set(Path(scene).resolve().name, loaded, settings.model.background, settings.model.depth_mode)
    snapshots = Snapshots(settings.schedule.steps)
    with Page(viewed, host=host, port=port, news=snapshots.news, share=SHARE) as page:
        _tell(f"{page.address} shows the training while it goes on")
        answering = Thread(target=page.work, name="page")
        answering.start()
        try:
            yield snapshots.observe
        finally:
            page.close()
            answering.join()


def _tell(line: str) -> None:
    print(f"view: {line}", file=sys.stderr)
