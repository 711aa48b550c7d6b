"""Recordings by users: tables in many dialects, and the signals in them."""
