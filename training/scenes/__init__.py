"""Driving scenes: streets that are ray-cast to images, depth, classes and LiDAR scans.

Other packages read the folders that `ssdnet-render` writes. Tests and benchmarks that need frames
import only `scene_job`. The files in the order of execution:

| file | content |
|---|---|
| cli | options of the command; one `SceneJob` per scene; processes |
| scene_job | one scene, from its seed to its folder |
| names | names of streets, variants of light, cameras and classes |
| layout/street | the street of a seed, made by the following files in this order |
| layout/site | lanes, pavements, side roads, bends, slopes; places meshes |
| layout/ground | carriageway, kerbs, pavements, grass; road paint |
| layout/frontage | houses, gardens, trees, the horizon |
| layout/furnishing | lamps, signs, clutter, parked cars |
| layout/traffic | vehicles, cyclists and pedestrians that move |
| things/ | the meshes of all these; mesh.py has the basic shapes |
| rendering/ | camera, weather and the LiDAR's mount (lidar_scan), drawn once per scene |
| rendering/render | one frame, made by the following files |
| rendering/raycast | what the rays hit |
| rendering/shading | the light of what they hit |
| rendering/lidar_scan | the LiDAR's returns |
| textures/surfaces | the material of the hit points, from the file of each kind of surface |
"""
