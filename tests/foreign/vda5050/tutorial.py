"""Plays docs/tutorials/vda5050.md: writes its files, runs its commands, and compares the output."""
import os
import re
import signal
import subprocess
from pathlib import Path

from processes import free_port

PAGE = Path(__file__).resolve().parents[3] / "docs/tutorials/vda5050.md"


def blocks():
    return re.findall(r"^```(\w+)\n(.*?)^```$", PAGE.read_text(), re.M | re.S)


def matches(pattern, output):
    """Checks whether a line of the output is a line of the page, in which `…` stands for any text."""
    expression = ".*".join(re.escape(part) for part in pattern.split("…"))
    return any(re.fullmatch(expression, line) for line in output.splitlines())


def play(case):
    port, commands, checked = free_port(), 0, 0
    (case.folder / "node_modules").symlink_to(case.kit / "node_modules")
    programs = case.folder / "bin"
    programs.mkdir()
    (programs / "consort-vda5050").symlink_to(case.program)
    # The package is installed already, and the port may be in use.
    (programs / "npm").symlink_to("/bin/true")
    environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}", "RUST_LOG": "warn"}
    shell = subprocess.Popen(["bash", "-e"], cwd=case.folder, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                             stderr=subprocess.STDOUT, text=True, start_new_session=True)
    output = ""
    try:
        for language, text in blocks():
            text = text.replace("1883", str(port))
            name = re.match(r"(?:#|//) ([\w.]+)\n", text)
            if name:
                (case.folder / name[1]).write_text(text)
            elif language == "sh":
                shell.stdin.write(text.replace(" &\n", " >background.log 2>&1 </dev/null &\n") + "\necho END-OF-BLOCK $?\n")
                shell.stdin.flush()
                output = ""
                for line in shell.stdout:
                    if line.startswith("END-OF-BLOCK"):
                        break
                    output += line
                else:
                    raise AssertionError(f"the commands end early: {text}: {output[-800:]}")
                commands += sum(1 for line in text.splitlines() if line and not line.startswith((" ", "(")))
            elif language == "text" and commands and checked < 3:
                checked += 1
                missing = [line for line in text.splitlines() if not matches(line, output)]
                assert not missing, f"{missing} is not in {output[-1500:]}"
    finally:
        os.killpg(shell.pid, signal.SIGKILL)
        shell.wait()
    assert checked == 3, f"{checked} outputs were compared"
    return f"{commands} commands"
