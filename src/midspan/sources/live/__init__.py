"""Where live records come from: MQTT blocks, serial lines, cameras on the network and on USB."""
