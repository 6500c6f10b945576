"""What is wrong with what the sensors send, found before the answer is believed."""
