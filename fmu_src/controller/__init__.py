"""Assemblies that turn estimated motion into piezo voltages."""
