"""Recordings that people bring: tables in many dialects, and what they hold."""
