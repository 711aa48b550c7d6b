"""Systems in the SSP 1.0 standard (System Structure and Parameterization), out and in.

    from harness.ssp.export import export
    from harness.ssp.load import load

    export("closed_loop", Path("closed_loop.ssp"))
    load(Path("elsewhere.ssp"), Path("elsewhere"))      # a folder with a scenario and its FMUs

SSP knows components, connectors, connections, units and parameter sets. It knows no delay on a
connection and no order of execution: those are the importing tool's. What is meant here:

- An exported file lists its components in the order in which the harness runs them, and an imported
  loop is closed by one sample of delay where `harness.ssp.order` says. A scenario whose delays are
  not those is not exported, because nobody who reads the file would know of them.
- A tool with a Jacobi master (libcosim, Ecos: all FMUs step at once, then all values pass) delays
  every connection by one communication step. An FMU that samples on its own clock sees at its
  sample what the others had put out before it, so between FMUs of one sample period the delay is
  that period, however short the communication step is. `harness.ssp.order.lag` tells how much later
  than in the harness signals arrive; the exported file's description says it, too.

For the closed loop that is 1 ms at the instrument and 4 ms at the controller with communication
steps of 0.1 ms, the sample period of the stacks: hand and uncompensated tip are the harness's to
the bit, the correction comes 3 ms later. A controller that is told so gives the harness's figures:

    steadytip ssp export closed_loop --set part.controller.filter.horizon=4.3e-3

Reduction in band and a-posteriori in per cent, 20 s; libcosim and Ecos agree to the bit:

| seed | harness | tool, horizon 4.3 ms | tool, horizon as it is (1.3 ms) |
| --- | --- | --- | --- |
| 20 (the scenario's) | 68.9, 59.4 | 68.8, 61.2 | 74.0, 62.9 |
| 1 | 73.7, 55.4 | 73.2, 58.1 | 63.3, 48.6 |
| 2 | 68.0, 50.0 | 67.3, 52.1 | 61.2, 45.5 |
| 3 | 68.5, 39.5 | 68.4, 42.4 | 67.8, 39.0 |

What SSP cannot hold is refused by name: parts that are no FMUs, recordings, delays other than the
above. The scenario's `signals` and `settle` have no place in it either; they are for the metrics
only, and `--set` gives them to a run of an imported file.
"""
