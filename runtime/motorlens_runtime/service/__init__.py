"""A sensor that runs for months: the loop, alarms, queues to publishers, recorder, memory of the heat, change of sensor."""
