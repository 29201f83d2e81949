"""Check libraries, device, engine, memory, disk and cache, and say what to type.

Loads each library that gsjax needs and compares its version, asks jax for its device and
the rasterizer for its engine, and checks memory, disk and the folder of compiled programs.
Where something is amiss, a line says what to type. Ends with code 0 if all is well, else 1.

Example: gsjax doctor --json
"""

from gsjax.cli.parsers import Command


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")


def run(json: bool = False) -> int:
    """Print the findings; return the exit code."""
    from dataclasses import asdict
    from json import dumps

    from gsjax.io.installation import examine

    findings = []
    for finding in examine():
        findings.append(finding)
        if not json:
            print(f"{'ok ' if finding.is_fine else 'BAD'}  {finding.name:<32}{finding.result}", flush=True)
            if not finding.is_fine:
                print(f"     {'':<32}type: {finding.remedy}")
    is_well = all(finding.is_fine for finding in findings)
    if json:
        print(dumps({"is_well": is_well, "findings": [asdict(finding) for finding in findings]}, indent=2))
    return 0 if is_well else 1
