"""Formats of others: maps and surveys as files, in and out.

Pure functions between bytes and engine types; no database, no HTTP. :mod:`app.exchange.maps` writes and reads maps
(netCDF, GeoTIFF, ESRI ASCII, XYZ), :mod:`app.exchange.surveys` reads recordings with positions (CSV, GetSensorData
logs) and writes and reads survey archives, :mod:`app.exchange.phones` reads what phones send and export.

What is read comes from anywhere: every reader checks sizes before it allocates, and whatever is wrong becomes an
:class:`app.engine.errors.InputError` that names the place and the remedy.
"""
