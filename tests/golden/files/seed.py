"""Print the designs, in hexadecimal digits, and the outcomes of three of the campaigns here with another seed."""

import json
import re
import sys
import tempfile
from pathlib import Path

import activefail

if __name__ == "__main__":
    here, seed, found = Path(__file__).parent, sys.argv[1], {}
    for name in ("asynchronous", "margins", "rare"):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "campaign.toml")
            file.write_text(re.sub(r"^seed = .*", f"seed = {seed}", (here / f"{name}.toml").read_text(), flags=re.M))
            file.with_name("plate.py").write_text((here / "plate.py").read_text())
            with activefail.create_run(Path(folder, "run"), file) as run:
                run.take(workers=1, progress=False)
                table = run.simulations
                designs = table[list(run.space.names)].to_numpy().tolist()
                found[name] = [[v.hex() for v in design] for design in designs], table["outcome"].tolist()
    print(json.dumps(found))
