"""`steadytip validate`: the checklist of a drop-in FMI 2.0 co-simulation FMU, checked by program.

    checks      what a check is, and the lists of them
    files       the FMU as a file; archive, description, structure, binary: checks of it (A, B, C)
    variables   its variables, resolved by the rules of the standard
    probes/     checks of the running FMU (B, C, D), each in a process of its own with a time limit
    running     starts those processes, and makes a result of a crash or a hang
    reports     JSON and JUnit XML

On anybody's FMU. This file imports nothing: every process of a probe passes through it.
"""
