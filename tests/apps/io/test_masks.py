"""Masks as files."""

from pathlib import Path

import pytest
from rsmcm.apps.io.masks import MaskWriter

from ...support.film import mask, names


def test_masks_none_and_unknown(tmp_path: Path) -> None:
    with MaskWriter(tmp_path, "none", 10) as writer:
        writer.write(mask(1), 1, 0.0)
    assert names(tmp_path) == set()
    with pytest.raises(ValueError, match="masks: got 'gif', expected none, png or video"):
        MaskWriter(tmp_path, "gif", 10)  # type: ignore[arg-type]
