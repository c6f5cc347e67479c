//! Links that break and are back before anybody's routes have caught up: whoever is linked hears and is heard.

use bytes::Bytes;
use consort_actors::bus::{Bus, Encoding, ZenohBus, ZenohSettings};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::broadcast;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

/// Longest wait for what must happen.
const PATIENCE: Duration = Duration::from_secs(40);

async fn router(connect: &[String]) -> ZenohBus {
    ZenohBus::open(ZenohSettings { connect: connect.to_vec(), ..ZenohSettings::default() }).await.unwrap()
}

/// Answers every question on `key`.
async fn serve(bus: &ZenohBus, key: &'static str) -> JoinHandle<()> {
    let mut questions = bus.serve(key).await.unwrap();
    tokio::spawn(async move {
        while let Some(question) = questions.recv().await {
            // Whoever asked may have gone.
            let _ = question.replier.reply(key, Bytes::new(), Encoding::Wire).await;
        }
    })
}

async fn answers(bus: &ZenohBus, key: &str) -> bool {
    match bus.query(key, Bytes::new(), Duration::from_millis(500)).await {
        Ok(mut replies) => replies.recv().await.is_some(),
        Err(_) => false, // it has no session just now
    }
}

async fn until_answered(bus: &ZenohBus, key: &str, when: &str) {
    let end = Instant::now() + PATIENCE;
    while !answers(bus, key).await {
        assert!(Instant::now() < end, "{when}: {key} does not answer");
        sleep(Duration::from_millis(50)).await;
    }
}

/// A cable that can be pulled out and put back within a moment.
struct Cable {
    address: String,
    pull: broadcast::Sender<()>,
}

impl Cable {
    async fn to(bus: &ZenohBus) -> Cable {
        let end = bus.listen_addresses().await[0].trim_start_matches("tcp/").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("tcp/{}", listener.local_addr().unwrap());
        let (pull, _) = broadcast::channel(4);
        let pulled = pull.clone();
        tokio::spawn(async move {
            while let Ok((mut near, _)) = listener.accept().await {
                let (end, mut pulled) = (end.clone(), pulled.subscribe());
                tokio::spawn(async move {
                    let Ok(mut far) = TcpStream::connect(end).await else { return };
                    tokio::select! {
                        _ = tokio::io::copy_bidirectional(&mut near, &mut far) => {}
                        _ = pulled.recv() => {}
                    }
                });
            }
        });
        Cable { address, pull }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_link_that_is_cut_and_back_at_once_leaves_nobody_deaf() {
    let far = router(&[]).await;
    let middle = router(&far.listen_addresses().await).await;
    let cable = Cable::to(&middle).await;
    let near = router(std::slice::from_ref(&cable.address)).await;
    let services =
        [serve(&far, "relink/far").await, serve(&middle, "relink/middle").await, serve(&near, "relink/near").await];
    for round in 0..3 {
        for (bus, keys) in [
            (&near, ["relink/middle", "relink/far"]),
            (&middle, ["relink/near", "relink/far"]),
            (&far, ["relink/near", "relink/middle"]),
        ] {
            for key in keys {
                until_answered(bus, key, &format!("after {round} cuts")).await;
            }
        }
        cable.pull.send(()).expect("the cable is in use");
    }
    services.iter().for_each(JoinHandle::abort);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_is_replaced_at_once_hears_everybody_and_is_heard() {
    let far = router(&[]).await;
    let middle = router(&far.listen_addresses().await).await;
    let _services = [serve(&far, "replaced/far").await, serve(&middle, "replaced/middle").await];
    let connect = middle.listen_addresses().await;
    for life in 0..4 {
        let near = router(&connect).await;
        let service = serve(&near, "replaced/near").await;
        for key in ["replaced/middle", "replaced/far"] {
            until_answered(&near, key, &format!("in life {life}")).await;
        }
        for bus in [&middle, &far] {
            until_answered(bus, "replaced/near", &format!("in life {life}")).await;
        }
        service.abort();
        near.close().await.unwrap();
    }
}

/// A router with Zenoh and nothing of ours.
async fn foreign(admin_space: bool) -> (zenoh::Session, Vec<String>) {
    let mut config = zenoh::Config::default();
    for (path, value) in [
        ("mode", "\"router\""),
        ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]"),
        ("scouting/multicast/enabled", "false"),
        ("adminspace/enabled", if admin_space { "true" } else { "false" }),
    ] {
        config.insert_json5(path, value).unwrap();
    }
    let session = zenoh::open(config).await.unwrap();
    let listening = session.info().locators().await.iter().map(ToString::to_string).collect();
    (session, listening)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_router_that_is_none_of_ours_is_asked_for_its_admin_space_and_left_alone() {
    let (_stock, to_stock) = foreign(true).await;
    let (_mute, to_mute) = foreign(false).await;
    let (first, second) = (router(&to_stock).await, router(&to_mute).await);
    let (at_stock, at_mute) = (first.id(), second.id());
    let end = Instant::now() + PATIENCE;
    // Whoever says nothing at all may be deaf; the other was asked at least as often by then.
    while second.id() == at_mute {
        assert!(Instant::now() < end, "a neighbour that says nothing is left alone");
        sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(first.id(), at_stock);
}
