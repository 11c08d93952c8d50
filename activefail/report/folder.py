"""The folder of files that an analysis writes: pages and other texts, tables, and pictures."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from activefail.figures.style import save_png_and_svg
from activefail.files import make_folder, replacing, target_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_folder(
    folder: Path, files: Mapping[str, str | Callable[[Path], None]], figures: "Mapping[str, Figure]"
) -> list[Path]:
    """Write files into a folder, which is made if it is missing; returns them.

    Args:
        folder: of the files.
        files: text, or what writes a table, by name of the file.
        figures: by name of the picture, which is written as PNG and SVG.

    Raises:
        InputError, OSError: if a file cannot be written.
    """
    make_folder(folder)
    for name, content in files.items():
        if callable(content):
            content(folder / name)
            continue
        with replacing(target_of(folder / name)) as file:
            file.write(content)
    pictures = [path for name, figure in figures.items() for path in save_png_and_svg(figure, folder, name)]
    return [*(folder / name for name in files), *pictures]
