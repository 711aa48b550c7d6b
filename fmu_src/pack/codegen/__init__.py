"""C code of a model: its functions from CasADi, optimised, and the FMI shell around them."""
