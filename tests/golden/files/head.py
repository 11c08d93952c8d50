"""Print the first lines of a table without the wall times."""

import csv
import sys

with open(sys.argv[1], newline="") as file:
    for row in list(csv.DictReader(file))[:6]:
        print(*(f"{name}={cell}" for name, cell in row.items() if name != "seconds"))
