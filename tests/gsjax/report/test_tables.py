from gsjax.report import tables


def test_a_record_is_aligned_and_flattened():
    text = tables.record({"psnr": 29.123456, "gaussians": 36000, "fscore": None, "versions": {"jax": "0.10.2"}})
    assert text.splitlines() == [
        "psnr          29.12",
        "gaussians     36,000",
        "fscore        -",
        "versions.jax  0.10.2",
    ]


def test_variants_are_rows_and_gaps_are_shown():
    text = tables.compare({"vanilla": {"psnr": 29.0, "gaussians": 10}, "surface": {"psnr": 30.25, "chamfer": 1e-5}})
    assert text.splitlines() == [
        "          psnr  gaussians  chamfer",
        "vanilla     29         10        -",
        "surface  30.25          -    1e-05",
    ]


def test_rows_of_several_seeds_are_shown_with_least_and_most():
    rows = [{"fscore": 0.5, "psnr": 30.0}, {"fscore": 0.7, "psnr": 33.0}, {"fscore": 0.6, "psnr": 30.0}]
    assert tables.spread(rows) == {"fscore": "0.6 [0.5 0.7]", "psnr": "31 [30 33]"}


def test_one_seed_has_no_least_and_most():
    assert tables.spread([{"psnr": 30.25, "gaussians": 20_000}]) == {"psnr": "30.25", "gaussians": "20,000"}
