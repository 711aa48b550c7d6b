"""The papers' tables and figures, measured again with this software.

A module here that holds an `ITEM` is one table or figure (or a tight group of them):

    ITEM = Item(
        name="table-6.1",
        source="A04 table 6.1",
        title="Reach and speed of the manipulator",
        group="manipulator",
        run=run,
    )

with `run(context) -> Outcome`. Put the file here and `steadytip reproduce` has it: nothing else
names it. Such modules import nothing heavy before they run, so that the list of them comes at once;
what several of them share stands in `bench`.
"""
