"""Record of a run: written, read, and judged by figures of merit."""
