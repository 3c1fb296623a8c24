"""How often a table like Table II names its cause: simulated tables, diagnosed as the measured.

    python benchmarks/table2_rehearsal.py [--tables 40] [--workers 2] [--write]

The study `cablesense paper --only sim_to_real` takes its probabilities from these counts.
"""

from __future__ import annotations

import harness

from cablesense_base import CableSenseError
from cablesense_base.files import write_atomically
from examples.paper.table_2_gap import REHEARSAL, diagnose_table


def main() -> None:
    """Draws tables of every kind, diagnoses each, and prints the counts."""
    parser = harness.parser(__doc__, REHEARSAL.name)
    parser.add_argument("--tables", type=int, default=40, help="simulated tables of each kind")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    options = parser.parse_args()
    found = diagnose_table(options.tables, lambda _: None, options.workers)
    counts = found.rehearsal.model_dump_json(indent=1) + "\n"
    print(counts)
    if options.write:
        write_atomically(REHEARSAL, counts, CableSenseError)


if __name__ == "__main__":
    main()
