"""Figures of speed and size: `steadytip bench`.

Each group of benchmarks is a file of `suite/`, run by pytest with pytest-benchmark, which does the
measuring. They give their numbers to `BenchResults`, from which figures, tables and `SPEED.md` are
made.
Nothing is judged: machines are shared, and slower ones exist.
"""
