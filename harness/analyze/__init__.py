"""The delay budget of a loop: what it leaves of a motion, what parts cost, what delay it bears.

    from harness.analyze.analysis import analyze
    analyze("closed_loop", wanted=0.5).budget.spare        # [s]

`operating` runs the loop with a hand that moves by multisines, `alone` drives each FMU alone,
`linear` joins their responses, `stages` and `budget` read them. Modules are imported when they are
used: python-control takes a second.
"""
