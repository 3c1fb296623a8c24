"""The gap between Table II's physical rows and this project's simulation of the same loads.

    python benchmarks/table2_gap.py [--tables 40] [--out benchmarks/table2] [--workers 2] [--ship]

54 measured changes of tension: nine cables, 1 and 2 kg on each of three segments. Writes
`verdict.json`, `report.html` and `README.md`. Explanations are fitted to some rows and judged on
others; `--tables` of each kind are simulated and diagnosed in the same way for the probability.
`--ship` also writes their counts where `cablesense paper --quick` finds them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from table2_page import page

from cablesense_gap.verdict import write_verdict
from cablesense_paper.table_2_gap import SHIPPED, diagnose_table, write_rehearsal
from cablesense_paper.table_2_text import readme, worded


def main() -> None:
    """Diagnoses, prints the README and writes the files."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tables", type=int, default=40, help="simulated tables of each kind")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "table2")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--ship", action="store_true", help=f"write {SHIPPED.name} too")
    options = parser.parse_args()
    command = f"python benchmarks/table2_gap.py {' '.join(sys.argv[1:])}".strip()
    found = worded(diagnose_table(options.tables, command, _tell, options.workers))
    options.out.mkdir(parents=True, exist_ok=True)
    write_verdict(options.out / "verdict.json", found.verdict)
    (options.out / "report.html").write_text(page(found), encoding="utf-8")
    text = readme(found)
    (options.out / "README.md").write_text(text, encoding="utf-8")
    if options.ship:
        write_rehearsal(SHIPPED, found.rehearsal)
    print(text)


def _tell(done: float) -> None:
    print(f"\r{done:.0%} …", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
