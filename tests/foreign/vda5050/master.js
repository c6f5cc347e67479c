// Fleet control of vda-5050-lib 1.4.0: node master.js KIT BROKER_URL SERIAL. It orders a vehicle from Dock to Ward with a
// pick on the way, to Shelf, and to Dock; it cancels the last drive. It prints how the orders end.
const [kit, brokerUrl, serialNumber] = process.argv.slice(2);
const { MasterController, BlockingType } = require(`${kit}/node_modules/vda-5050-lib`);

const vehicle = { manufacturer: "Consort", serialNumber };
const places = { Dock: 0, Shelf: 4, Ward: 8 };

function order(names, actions) {
    const orderId = `order-to-${names[names.length - 1]}`;
    const nodes = names.map((nodeId, index) => ({
        nodeId, sequenceId: 2 * index, released: true, nodePosition: { x: places[nodeId], y: 0, mapId: "hall" }, actions: actions[nodeId] || [],
    }));
    const edges = names.slice(1).map((endNodeId, index) => ({
        edgeId: `${names[index]}_${endNodeId}`, sequenceId: 2 * index + 1, released: true, startNodeId: names[index], endNodeId, actions: [],
    }));
    return { orderId, orderUpdateId: 0, nodes, edges };
}

async function main() {
    const master = new MasterController(
        { interfaceName: "uagv", transport: { brokerUrl, heartbeat: 2, connectTimeout: 2000 }, vdaVersion: "2.0.0",
          topicObjectValidation: { inbound: true, outbound: true } }, {});
    await master.start();
    console.log("started");
    const assign = (names, actions, onDrive) => new Promise(resolve => {
        const assigned = order(names, actions);
        master.assignOrder(vehicle, assigned, {
            onEdgeTraversing: onDrive,
            onOrderProcessed: (withError, byCancelation) => {
                console.log(`ended ${assigned.orderId} ${withError ? "error" : byCancelation ? "cancelled" : "done"}`);
                resolve();
            },
        });
    });
    const pick = { actionId: "pick-1", actionType: "pick", blockingType: BlockingType.Hard };
    await assign(["Dock", "Shelf", "Ward"], { Shelf: [pick] });
    await assign(["Ward", "Shelf"], {});
    const cancel = { actionId: "cancel-1", actionType: "cancelOrder", blockingType: BlockingType.Hard };
    const handler = {
        onActionStateChanged: state => console.log(`${state.actionType} ${state.actionStatus}`),
        onActionError: error => console.log(`cancelOrder ${error.errorDescription}`),
    };
    let isCancelled = false;
    await assign(["Shelf", "Dock"], {}, () => {
        if (!isCancelled) master.initiateInstantActions(vehicle, { instantActions: [cancel] }, handler);
        isCancelled = true;
    });
}
main().catch(problem => { console.error(problem); process.exit(1); });
