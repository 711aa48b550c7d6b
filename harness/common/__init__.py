"""What every layer of the harness uses: errors, files, units, figures. Knows nothing of runs."""
