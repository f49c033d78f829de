"""Prints what the server's MQTT gateway says under a topic: a line READY, then one a message: topic, space, payload."""

import sys

import paho.mqtt.client as mqtt

port, topic = int(sys.argv[1]), sys.argv[2]
client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="celld-test", protocol=mqtt.MQTTv311)
client.on_connect = lambda client, userdata, flags, reason, properties: client.subscribe(topic, qos=1)
client.on_subscribe = lambda client, userdata, mid, reasons, properties: print("READY", flush=True)
client.on_message = lambda client, userdata, message: print(message.topic, message.payload.decode(), flush=True)
client.connect("127.0.0.1", port)
client.loop_forever()
