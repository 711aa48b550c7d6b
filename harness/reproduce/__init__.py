"""The papers' tables and figures, measured again with this software.

A module of `papers/` that declares an `ITEM` is one table or figure, or a tight group of them:

    ITEM = Item(
        name="table-6.1",
        source="A04 table 6.1",
        title="Reach and speed of the manipulator",
        group="manipulator",
        run=run,
    )

with `run(context) -> ItemResult`. Put the file into the folder of its paper and
`steadytip reproduce` finds it. The list of items reads `ITEM` and the text constants of each module
(`SOURCE = ...`) without importing the module, so that the list comes at once. `experiments/` holds
what several items share.
"""
