"""The programs that PEERNet is compared with."""
