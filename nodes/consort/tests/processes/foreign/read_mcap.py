"""Reads a recording with the reference library of MCAP, and prints its contents as JSON."""

import json
import sys

from mcap.reader import make_reader

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    topics = {}
    latest = 0
    for schema, channel, message in reader.iter_messages():
        data = json.loads(message.data)
        definition = json.loads(schema.data)
        assert schema.encoding == "jsonschema" and channel.message_encoding == "json", channel
        assert definition["title"] == schema.name and definition["type"] == "object", schema.name
        missing = [name for name in definition["required"] if name not in data]
        assert not missing, f"{channel.topic}: {missing} of {data}"
        assert latest <= message.log_time, f"{channel.topic}: time goes back"
        latest = message.log_time
        topic = topics.setdefault(channel.topic, {"schema": schema.name, "messages": 0})
        topic["messages"] += 1
    assert sum(topic["messages"] for topic in topics.values()) == summary.statistics.message_count
    metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    print(json.dumps({"topics": topics, "metadata": metadata, "library": reader.get_header().library}))
