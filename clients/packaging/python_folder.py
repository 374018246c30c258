"""python_folder.py PREFIX: prints the folder below PREFIX where this Python finds modules."""

from __future__ import annotations

import sys
import sysconfig

prefix = sys.argv[1].rstrip("/")
searched = [
    path
    for path in sys.path
    if path.startswith(f"{prefix}/lib/") and path.endswith(("/site-packages", "/dist-packages"))
]
usual = f"{prefix}/lib/python{sysconfig.get_python_version()}/site-packages"
print(searched[0] if searched else usual)
