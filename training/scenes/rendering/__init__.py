"""From a street to a picture: camera, rays, light, weather and sensor."""
