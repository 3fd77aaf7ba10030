"""Files, bags and messages that the commands read and write."""
