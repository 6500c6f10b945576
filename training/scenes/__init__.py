"""Driving scenes: streets that are ray-cast to images, depth, classes and LiDAR scans.

Other packages read the folders that `ssdnet-render` writes. Tests and benchmarks that need frames
import `scene_job` alone. The files, in the order of execution:

cli                 options of the command; one `SceneJob` a scene; processes
scene_job           one scene, from its seed to its folder
names               of streets, variants of light, cameras and classes
layout/street       the street of a seed, made by, in this order:
  site                lanes, pavements, side roads, bends, slopes; places a mesh there
  ground              carriageway, kerbs, pavements, grass
  frontage            houses, gardens, trees, the horizon
  furnishing          lamps, signs, clutter, parked cars
  traffic             vehicles, cyclists and pedestrians that move
  markings            road paint
things/             the meshes of all these; mesh.py has the basic shapes
rendering/          drawn once a scene: camera, weather, and the LiDAR's mount (lidar_scan)
rendering/render    one frame:
  raycast             what the rays hit
  shading             its light
  lidar_scan          the LiDAR's returns
textures/surfaces   the material of the hit points, from the file of each kind of surface
vkitti_writer       the folder of the scene

bundled_stream_maker is a command of its own, which made the recording that is installed.
"""
