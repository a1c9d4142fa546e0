"""Collect records, and make the page of results and README's figures: `make results`.

    python -m rsmcm.apps.experiments.results [FOLDER]

takes the records that experiments have left in the folders of FOLDER (`results`), keeps them without every
run's measures in `docs/results/`, and writes `docs/results.md`, the parts of `README.md` and `docs/scale.md`
between their marks, and the picture of the latter. Only in a checkout.
"""

import sys
from pathlib import Path

from ....models.files import write_text
from ..record import ROOT, Record
from .pages import Documents, readme_with, results_page
from .scale_page import CURVES, PAGE, PICTURE, scale_page, write_picture

KEPT = ROOT / "docs" / "results"


def main(folder: Path) -> int:
    """Collect and write; 2 if a file cannot be read or written."""
    try:
        collect(folder, KEPT)
        write_pages(ROOT)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def collect(folder: Path, kept: Path) -> None:
    """Keep what has been recorded in the folders of `folder`, if nothing younger is kept.

    Raises
    ------
    OSError, ValueError
        if a record cannot be read or written.
    """
    for path in sorted([*folder.glob("*/results.json"), *folder.glob("*/benchmarks.json")]):
        record = Record.read(path)
        place = kept / f"{record.name}.json"
        if not place.exists() or Record.read(place).made.date < record.made.date:
            record.write(place)
            print(f"{record.name}: {record.made.date}")


def write_pages(root: Path) -> None:
    """Write the page of results, the figures of README, and those of the page on scale, of a checkout.

    Raises
    ------
    OSError, ValueError
        if something cannot be read or written.
    """
    documents, readme = Documents.read(root / "docs" / "results"), root / "README.md"
    write_text(root / "docs" / "results.md", results_page(documents, root))
    write_text(readme, readme_with(readme.read_text(), documents, root))
    page = root / PAGE
    write_text(page, scale_page(page.read_text(), documents.records, root))
    if CURVES in documents.records:
        write_picture(documents.records[CURVES], root / PICTURE)


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "results")))
