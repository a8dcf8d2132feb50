"""Series of numbers from any file: channels, the times that belong to each, and three axes as one."""
