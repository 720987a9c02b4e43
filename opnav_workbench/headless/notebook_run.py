"""One notebook executed in a process of its own: ``python notebook_run.py job.json``.

`opnav_workbench.headless.night_workers` starts it by its path, so that it loads papermill and nothing else of this package;
what happened stands in the job's ``report`` file. It ends with its starter, and takes its kernel along.  A copy of
`opnav_workbench.headless.warm_server` calls `main`, with an engine that needs no other process.
"""

import json
import os
import re
import sys
import threading
import time
from pathlib import Path
from typing import Any

STARTER_CHECK_S = 1.0
KERNEL_START_S = 120  # a loaded machine with many workers starts kernels slowly
# A report in a browser must not ask the network for anything.
WITHOUT_NETWORK = dict.fromkeys(("jquery_url", "mathjax_url", "mermaid_js_url", "require_js_url"), "")
EMPTY_SCRIPT = re.compile(r'<script src="">\s*</script>')


def main(path: str, engine: str | None = None) -> None:
    """Carry out the job in a file.

    Parameters
    ----------
    engine
        One that papermill knows; default papermill's own, which starts a kernel.
    """
    job: dict[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
    starter = os.getppid() if engine else job["starter"]
    threading.Thread(target=_end_with, args=(starter,), daemon=True).start()
    report = _executed(job, engine)
    if Path(job["executed"]).is_file() and _is_page_wanted(job):
        try:
            Path(job["html"]).write_text(notebook_html(Path(job["executed"])), encoding="utf-8")
        except Exception as error:
            report["html_error"] = f"{type(error).__name__}: {error}"
    temporary = Path(job["report"] + ".part")
    temporary.write_text(json.dumps(report), encoding="utf-8")
    temporary.replace(job["report"])


def _end_with(starter: int) -> None:
    """End this process and its kernel when the one that started it is gone."""
    while os.getppid() == starter:
        time.sleep(STARTER_CHECK_S)
    os._exit(1)  # the kernel watches us in the same way


def load_papermill() -> Any:
    """Import papermill, in a third of the time.

    jsonschema, which it needs, builds parsers of Internet names for a second if it finds the package for them; no notebook
    holds one, and without the package jsonschema goes without.
    """
    hidden = sys.modules.setdefault("rfc3987_syntax", None) is None  # type: ignore[arg-type]
    try:
        import papermill  # noqa: PLC0415  loaded when it is known to be needed
    finally:
        if hidden:
            del sys.modules["rfc3987_syntax"]
    return papermill


def for_papermill(path: str) -> str:
    """Return a path as papermill takes it, who fills parameters in between braces.

    Examples
    --------
    >>> for_papermill("night/a{1}.ipynb")
    'night/a{{1}}.ipynb'
    """
    return path.replace("{", "{{").replace("}", "}}")


def _executed(job: dict[str, Any], engine: str | None) -> dict[str, Any]:
    papermill = load_papermill()  # after the watch has begun: it takes half a second
    try:
        papermill.execute_notebook(
            for_papermill(job["notebook"]),
            for_papermill(job["executed"]),
            parameters=job["parameters"],
            engine_name=engine,
            kernel_name="python3",
            progress_bar=False,
            log_output=False,
            start_timeout=KERNEL_START_S,
            cwd=job["cwd"],
        )
    except papermill.exceptions.PapermillExecutionError as error:
        return {
            "ok": False,
            "kind": "cell",
            "ename": error.ename,
            "evalue": error.evalue,
            "traceback": error.traceback,
        }
    except Exception as error:
        return {
            "ok": False,
            "kind": "machine",
            "ename": type(error).__name__,
            "evalue": str(error),
            "traceback": [],
        }
    return {"ok": True}


def _is_page_wanted(job: dict[str, Any]) -> bool:
    """Tell whether somebody will read the notebook as a page: where it was asked for, or did not come out well."""
    if job["pages"] != "flagged":
        return bool(job["pages"] == "all")
    try:
        return bool(json.loads(Path(job["result"]).read_text(encoding="utf-8"))["status"] != "ok")
    except (OSError, ValueError, KeyError, TypeError):
        return True


def notebook_html(notebook: Path) -> str:
    """Return an executed notebook as a page that asks the network for nothing."""
    from nbconvert import HTMLExporter  # noqa: PLC0415

    exporter: Any = HTMLExporter(template_name="classic", embed_images=True, **WITHOUT_NETWORK)  # type: ignore[no-untyped-call]
    body, _ = exporter.from_filename(str(notebook))
    return EMPTY_SCRIPT.sub("", body)


if __name__ == "__main__":
    main(sys.argv[1])
