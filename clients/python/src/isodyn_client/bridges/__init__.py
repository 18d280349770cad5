"""From fixes to what other programs read: NMEA 0183, MAVLink, ROS 2. Bridges run beside the program that reads.

>>> from isodyn_client.bridges import GeoFix, NmeaEncoder
>>> fix = GeoFix(t=1764000000.0, latitude_deg=48.1173, longitude_deg=11.516667, var_east=4.0, cov_east_north=0.0,
...              var_north=1.0, course_deg=90.0, speed_m_s=None, claimed=True, number=0)
>>> print(NmeaEncoder().encode(fix).decode().split()[0])
$GPGGA,160000.00,4807.03800,N,01131.00002,E,6,00,0.45,,M,,M,,*6D
"""

from isodyn_client.bridges.feed import DeviceFeed, SessionFeed
from isodyn_client.bridges.mavlink import GpsInput, MavlinkEncoder
from isodyn_client.bridges.nmea import NmeaEncoder
from isodyn_client.bridges.place import GeoFix, Georeference
from isodyn_client.bridges.ros import nav_sat_fix, pose_with_covariance
from isodyn_client.bridges.sinks import SerialSink, Sink, StreamSink, TcpSink, UdpSink

__all__ = [
    "DeviceFeed",
    "GeoFix",
    "Georeference",
    "GpsInput",
    "MavlinkEncoder",
    "NmeaEncoder",
    "SerialSink",
    "SessionFeed",
    "Sink",
    "StreamSink",
    "TcpSink",
    "UdpSink",
    "nav_sat_fix",
    "pose_with_covariance",
]
