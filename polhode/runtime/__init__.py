"""The machine under the program: processes, threads, progress, interrupts, compiled code, output folders."""
