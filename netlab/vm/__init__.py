"""A kernel in a box: any command in a throw-away kernel, in real or virtual time, over the host's own files.

    caller: run.py -- job.json, init.py --> control folder (control.py, places.py)
       |                                        |  hostfs or 9p: up, stdout, stderr, status
       +-- lifeline --> keeper.py --> kernel (uml.py, qemu.py) --> guest.py, its init --> the command

``kernels.py`` chooses the kernel; ``recipe``, ``build``, ``packages``, ``cache`` and ``transfer`` provide it.
It knows nothing of labs and scenarios: they run in the box as any other command does.
"""
