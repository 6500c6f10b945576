"""Checks of the sensor data, to detect faults before an answer is used."""
