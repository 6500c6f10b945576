"""Checks, errors and time stamps that every other room uses."""
