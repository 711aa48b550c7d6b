"""Running an item, and finding one of its numbers."""

from harness.reproduce.catalogue import chosen, items
from harness.reproduce.item import Context


def run_item(name, data=None):
    """Run an item as the command does, and check what holds for all of them."""
    (item,) = chosen([name], items())
    assert bool(item.recordings) == (data is not None)
    shares = []
    outcome = item.run(Context(lambda share, what: shares.append(share), data))
    assert shares == sorted(shares)
    assert outcome.notes
    labels = [(figure.source, figure.quantity, figure.setting) for figure in outcome.figures]
    assert len(set(labels)) == len(labels)
    return outcome


def measured(outcome, *words):
    """Return the one number whose quantity and setting hold the words."""
    (found,) = [
        figure.measured
        for figure in outcome.figures
        if all(word in f"{figure.quantity}; {figure.setting}" for word in words)
    ]
    return found
