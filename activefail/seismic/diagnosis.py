"""What `activefail doctor` and the provenance of a campaign say of the bearing."""

from pathlib import Path

import numpy as np

from activefail.errors import SelfTestError
from activefail.visible import visible


def processor() -> str:
    """The processor for which numba compiles."""
    import llvmlite.binding as llvm

    return str(llvm.get_host_cpu_name())


def processor_features() -> str:
    """The features that it compiles for; two processors of the same name can differ in them."""
    import llvmlite.binding as llvm

    return ",".join(sorted(name for name, present in llvm.get_host_cpu_features().items() if present))


def kernels() -> str:
    """Where compiled kernels are kept."""
    from activefail.seismic.bearing.simulation import integrate

    folder = getattr(integrate._cache, "cache_path", None)
    if folder is None:
        return "not kept: no private folder can be written, so each process compiles the simulator"
    kept = any(Path(folder).glob("*.nbi"))
    return f"{'kept' if kept else 'will be compiled now, some 20 s, and kept'} in {visible(folder)}"


def simulator() -> str:
    """Simulate two bearings, of which one survives and one fails."""
    from activefail.seismic.bearing import simulate

    # T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k, T_p, A_p in the units of Table 1.
    weak = [3.0, 0.05, 0.45, 0.5, 0.05, 40.0, 1e9, 3.0, 0.8]
    strong = [3.0, 0.12, 0.85, 0.5, 0.2, 40.0, 1e9, 0.3, 0.1]
    outcomes = simulate(np.array([weak, strong])).outcome.tolist()
    if outcomes != [2, 0]:
        raise SelfTestError(f"the outcomes of two bearings are {outcomes}, not [2, 0]")
    return "two bearings have the right outcomes"
