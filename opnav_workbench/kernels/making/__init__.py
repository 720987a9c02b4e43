"""Kernels made from scenario files: trajectories, attitudes, clocks, frames, cameras, bodies and shapes.

Enter by `make_kernels`; `load_scenario` reads and checks a scenario alone. Listed from the ground up: a module uses
those above it. Nothing here knows named kernel sets: those stand above and are made by it.

``scenario_parts``
    Field types of scenario files; spacecraft, clock, frames, cameras, bodies.
``forces``
    Sun, planets and Moon as point masses; accelerations.
``scenario``
    Trajectories and pointing plan in a scenario file, and the whole file.
``nbody``
    Orbits integrated forward and backward, with impulses.
``orbits``
    Conics and integrated arcs as a scenario gives them.
``state_tables``
    States from rows and CSV files.
``trajectories``
    Every trajectory as SPK segments, sampled as SPICE needs.
``pool_variables``
    Variables of SCLK, FK, IK and PCK.
``attitude_history``
    Attitudes at nodes, in intervals; how close nodes must stand.
``steering``
    Attitudes of the windows of a pointing plan.
``attitude_error``
    Bias, drift and jitter of the flown attitude.
``make``
    All kernels of a scenario written into one folder.
"""
