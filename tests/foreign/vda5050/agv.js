// Virtual vehicles of vda-5050-lib 1.4.0: node agv.js KIT BROKER_URL COUNT [SPEED_MPS]
const [kit, brokerUrl, count, speed] = process.argv.slice(2);
const { AgvController, VirtualAgvAdapter } = require(`${kit}/node_modules/vda-5050-lib`);

async function main() {
    for (let number = 1; number <= Number(count); number++) {
        const agv = new AgvController(
            { manufacturer: "Foreign", serialNumber: `agv-${number}` },
            { interfaceName: "uagv", transport: { brokerUrl, heartbeat: 2, connectTimeout: 2000 }, vdaVersion: "2.0.0",
              topicObjectValidation: { inbound: true, outbound: true } },
            { agvAdapterType: VirtualAgvAdapter, publishStateInterval: 1000, publishVisualizationInterval: 500 },
            { initialPosition: { mapId: "hall", x: 0, y: 0, theta: 0, lastNodeId: "n1" }, vehicleSpeed: Number(speed || 2) });
        await agv.start();
    }
    console.log("started");
}
main().catch(problem => { console.error(problem); process.exit(1); });
