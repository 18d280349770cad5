"""The engine: pure numerics of geomagnetic positioning.

Conventions
-----------
Frames
    ``b``  body: Android sensor frame, x right, y to the top edge (forward), z out of the screen.
    ``n``  level frame: x, y plan metres, z up. Vectors are named ``v_n``, rotations ``c_nb`` (b to n).
    Angles in the level frame run counter-clockwise from +x.
Units
    Field in microtesla, acceleration m/s^2, rate rad/s, angle rad, length m.
Time
    UTC seconds as float64.
Field features
    ``vector`` (x, y, z of the level frame; needs a heading), ``hv`` (horizontal magnitude and vertical;
    needs only tilt), ``total`` (needs nothing).
Randomness
    An explicit ``numpy.random.Generator`` or a seed; nothing is drawn from global state.

Layers, lower ones never import higher ones::

    localization > filtering > mapping > inertial · calibration > geodesy > kernels
"""
