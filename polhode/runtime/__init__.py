"""The machine under the program: processes, threads, progress, interrupts, compiled code.

- errors: errors that end a command, with their exit codes; text that is safe to print
- argument_names: errors of the library in the words of Python, not of the command line
- console: progress bars or plain lines, and warnings, on the terminal
- progress: how stages report their progress; notes to the user
- interrupts: signals that end a command in order
- processes: work on many items, spread over processes; parent_death ends them with their parent
- threads: how many threads the libraries may use
- compiled: just-in-time compilation with a cache that knows its constants
- code_cache: where compiled code is kept: where no other user can put any
- program_digest: a digest of the program's files; optional_parts: packages that are not always installed
- drawing_style: pictures by matplotlib with its own settings
"""
