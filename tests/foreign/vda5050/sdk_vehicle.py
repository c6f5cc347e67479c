"""A vehicle of vda5050-sdk 0.2.0: python sdk_vehicle.py BROKER_URL. Its executor is that of the SDK."""
import asyncio
import sys

from vda5050.client.agv import OrderExecutor, VehicleClient
from vda5050.config import VehicleConfig
from vda5050.model.enums import ActionStatus


async def main():
    config = VehicleConfig(broker_url=sys.argv[1], manufacturer="Foreign", serial_number="sdk-1", state_interval=1.0,
                           protocol_version="2.1.0", validate_messages=True)
    client = VehicleClient(config)

    async def charge(action):
        client.report_action(action.action_id, ActionStatus.FINISHED, action_type=action.action_type)

    client.register_action_handler("startCharging", charge)
    await client.connect()
    client.publisher.update_position(x=0.0, y=0.0, theta=0.0, map_id="hall")
    client.publisher.mark_node_traversed("n1", 0)
    lock = asyncio.Lock()

    async def execute(order):
        # The client waits for its handlers, so the order is executed beside it.
        async def run():
            async with lock:
                await OrderExecutor(client.publisher, node_delay=0.3, action_delay=0.5).run(order)
                await client.publish_state()

        tasks.append(asyncio.create_task(run()))

    tasks = []
    client.on_order(execute)
    await client.publish_state()
    print("started", flush=True)
    await asyncio.Event().wait()


asyncio.run(main())
