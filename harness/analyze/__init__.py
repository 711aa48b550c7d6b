"""The delay budget of a loop: what it leaves of a motion, what parts cost, what delay it bears.

    from harness.analyze.analysis import analyze
    analyze("closed_loop", wanted=0.5).budget.spare        # [s]

`operating_point` runs the loop with a hand that moves by multisines. `part_response` drives each
FMU alone. `linear` joins the responses. `phase_budget` and `delay_budget` evaluate them. Modules
are imported when they are used: python-control takes a second.
"""
