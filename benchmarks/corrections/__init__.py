"""Every correction on trial: what is lost when it is taken out. See ``benchmarks.corrections.__main__``."""
