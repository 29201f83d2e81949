"""Pages have the tables of the newest results, and a table averages what its rows hold."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("script", "page"), [("accuracy_vs_time", "accuracy_vs_time.md"), ("effect_detection", "effects.md")]
)
def test_a_page_has_the_table_of_the_results(scripts, script, page):
    rows = json.loads((ROOT / f"experiments/results/{script}.json").read_text())["rows"]
    assert scripts(script).page_table(rows) in (ROOT / "docs" / page).read_text()


def test_presets_have_the_mean_over_seeds_and_half_of_the_range(scripts):
    row = {"scene": "room", "preset": "fast", "steps": 2150, "gaussians": 60_000, "ssim": 0.9, "mesh_normals": 28.0}
    row |= {"processor_seconds": 250.0, "f5": 0.74}
    rows = [row | {"vanilla": False, "seed": seed, "psnr": psnr} for seed, psnr in enumerate((29.0, 30.0))]
    rows.append(row | {"vanilla": True, "seed": 0, "psnr": 30.5})
    preset, vanilla = scripts("accuracy_vs_time").page_table(rows).splitlines()[2:]
    assert "| `fast` | self-supervised | 2,150; 60,000 | 250 +-0 | 29.50 +-0.50 dB |" in preset
    assert "| vanilla 3DGS, steps of `fast` | none |" in vanilla and "| 30.50 dB |" in vanilla
