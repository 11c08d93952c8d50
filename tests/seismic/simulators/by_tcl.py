"""Runs a Tcl script of OpenSees by openseespy: `python by_tcl.py model.tcl`, in an interpreter that has it.

The script itself runs in Tcl. Each command of OpenSees that it uses is passed on with its words, whole numbers as
integers and other numbers as floats, and a `pattern` with a block evaluates the block after it.
"""

import sys
import tkinter
from pathlib import Path

import openseespy.opensees as ops

COMMANDS = (
    *("algorithm", "analysis", "analyze", "constraints", "eigen", "element", "equalDOF", "fix", "frictionModel"),
    *("geomTransf", "getTime", "integrator", "load", "loadConst", "mass", "model", "node", "nodeCoord", "nodeDisp"),
    *("nodeVel", "numberer", "region", "system", "test", "timeSeries", "uniaxialMaterial", "wipe", "wipeAnalysis"),
)


def number(word):
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            pass
    return word


def main(script):
    tcl = tkinter.Tcl()

    def by(command):
        def call(*words):
            found = getattr(ops, command)(*map(number, words))
            if isinstance(found, list):
                return " ".join(map(repr, found))
            return "" if found is None else repr(found)

        return call

    def pattern(*words):
        block = words[-1] if words[0] == "Plain" else ""
        ops.pattern(*map(number, words[:-1] if block else words))
        return tcl.eval(block)

    for command in COMMANDS:
        tcl.createcommand(command, by(command))
    tcl.createcommand("pattern", pattern)
    tcl.eval(script)


main(Path(sys.argv[1]).read_text(encoding="utf-8"))
