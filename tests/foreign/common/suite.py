"""The cases of a suite. Each prints `pass NAME`, `fail NAME: why` or `skip NAME: why`."""
import pathlib
import shutil
import sys
import tempfile
import traceback


class Failed(AssertionError):
    """A condition of a case does not hold."""


class Skip(Exception):
    """A case cannot run here."""


def check(holds, why):
    if not holds:
        raise Failed(why)


class Suite:
    """The cases of a file, in their order. `prefix` precedes the names that are printed."""

    def __init__(self, name, prefix=""):
        self.name, self.prefix, self.cases = name, prefix, []

    def case(self, run):
        self.cases.append(run)
        return run

    def print_names(self):
        print("\n".join(f"{self.prefix}{run.__name__}" for run in self.cases))

    def run(self, names, open_case):
        """Runs the cases with these names, or all. `open_case` makes from a folder what a case gets, which has `close`.

        Returns the exit status. The folders of failed cases remain.
        """
        base, failed = pathlib.Path(tempfile.mkdtemp(prefix=f"consort-{self.name}-")), False
        for run in self.cases:
            name, folder = f"{self.prefix}{run.__name__}", base / run.__name__
            if names and run.__name__ not in names:
                continue
            opened, has_failed = None, False
            try:
                folder.mkdir()
                opened = open_case(folder)
                note = run(opened)
                print(f"pass {name}" + (f": {note}" if note else ""), flush=True)
            except Skip as reason:
                print(f"skip {name}: {reason}", flush=True)
            except Exception as problem:  # the next case is independent
                failed = has_failed = True
                print(f"fail {name}: {describe(problem, run)} (files: {folder})", flush=True)
            finally:
                if opened:
                    opened.close()
                if not has_failed:
                    shutil.rmtree(folder, ignore_errors=True)
        if not failed:
            shutil.rmtree(base, ignore_errors=True)
        return 1 if failed else 0


def describe(problem, run):
    """Returns a line about a problem: its place in the file of the case, and its text."""
    frames = traceback.extract_tb(problem.__traceback__)
    line = next((frame.lineno for frame in reversed(frames) if frame.filename == run.__code__.co_filename), 0)
    text = " ".join(str(problem).split())[:600] or type(problem).__name__
    if not isinstance(problem, AssertionError):
        text = f"{type(problem).__name__}: {text}"
        traceback.print_exception(problem, file=sys.stderr)
    return f"line {line}: {text}"
