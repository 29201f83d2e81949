"""Whether an installed wheel is whole: `python tests/installed_wheel.py CHECKOUT`, run by `make wheel`.

It must be run outside the checkout, by a Python whose path begins with the folder that the wheel was installed to.
"""

import sys
from pathlib import Path


def main(checkout: Path) -> None:
    """Prints one line; exits with another one where something is amiss."""
    import gsjax
    import rasterizer
    from gsjax import cli, pipeline

    for package in (gsjax, rasterizer):
        home = Path(package.__file__).parent
        if home.is_relative_to(checkout):
            sys.exit(f"{package.__name__} was imported from the checkout: {home}")
        files = [file for file in (checkout / package.__name__).rglob("*") if file.suffix not in ("", ".pyc")]
        missing = [str(file) for file in files if not (home.parent / file.relative_to(checkout)).is_file()]
        if missing or not files:
            sys.exit(f"the wheel lacks {', '.join(missing) or package.__name__}")
    cli.parser()
    print(f"the wheel holds all files of gsjax and rasterizer, and {len(pipeline.__all__)} commands' functions load")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
