//! The connection to the broker.

use crate::file::{BrokerAccess, TlsAccess};
use consort_vda5050_core::{Topic, Vehicle, Version};
use rumqttc::{AsyncClient, Event, LastWill, MqttOptions, Packet, QoS, SubscribeReasonCode, Transport};
use rustls::crypto::ring;
use serde_json::Value;
use std::time::Duration;
use tokio::sync::mpsc::{Receiver, channel};
use tokio::time::sleep;
use tracing::warn;

/// Interval of signs of life to the broker.
const KEEP_ALIVE: Duration = Duration::from_secs(5);

/// Maximum size of a message in bytes. States of long orders have some kilobytes.
const MESSAGE_BYTES_MAX: usize = 1 << 20;

/// Pause before the next attempt to connect.
const RECONNECT_AFTER: Duration = Duration::from_millis(500);

/// What happens on the connection.
#[derive(Debug)]
pub(crate) enum BrokerEvent {
    /// The connection is up, and the topics of the vehicle are subscribed.
    Up,
    /// The connection is down, with the cause; it is opened again.
    Down(String),
    /// A message on a subscribed topic.
    Message(Topic, Vec<u8>),
}

/// Publishes on the topics of the vehicle.
#[derive(Debug)]
pub(crate) struct Publisher {
    client: AsyncClient,
    vehicle: Vehicle,
}

impl Publisher {
    /// Publishes a message with the quality of service that the standard prescribes. A lost message is
    /// sent again by the state machine.
    pub(crate) fn publish(&self, topic: Topic, message: &Value) -> Result<(), rumqttc::ClientError> {
        let is_retained = match topic {
            Topic::Connection => true,
            Topic::Factsheet => self.vehicle.version() == Version::V3_0,
            _ => false,
        };
        self.client.try_publish(self.vehicle.topic(topic), qos(topic), is_retained, message.to_string())
    }

    pub(crate) fn close(&self) {
        // Without a connection there is nothing to close.
        let _ = self.client.try_disconnect();
    }
}

fn qos(topic: Topic) -> QoS {
    if topic == Topic::Connection { QoS::AtLeastOnce } else { QoS::AtMostOnce }
}

/// What a client does on the topics of a vehicle.
pub(crate) enum Side<'a> {
    /// Fleet control: it subscribes to the topics that the vehicle publishes.
    FleetControl,
    /// The vehicle: it subscribes to the other topics. The broker publishes the message on the topic
    /// `connection` when it loses the connection.
    Vehicle { last_will: &'a Value },
}

/// Connects to the broker, and again after each loss. Only the topics of the vehicle are subscribed.
pub(crate) fn connect(
    access: &BrokerAccess,
    vehicle: &Vehicle,
    client_id: &str,
    side: Side<'_>,
) -> (Publisher, Receiver<BrokerEvent>) {
    let mut options = MqttOptions::new(client_id, &access.host, access.port);
    let subscribed: &'static [Topic] = match side {
        Side::FleetControl => &Topic::OF_VEHICLES,
        Side::Vehicle { last_will } => {
            let topic = vehicle.topic(Topic::Connection);
            options.set_last_will(LastWill::new(topic, last_will.to_string(), QoS::AtLeastOnce, true));
            &Topic::OF_FLEET_CONTROL
        }
    };
    options.set_keep_alive(KEEP_ALIVE).set_max_packet_size(MESSAGE_BYTES_MAX, MESSAGE_BYTES_MAX);
    if let Some((user, password)) = &access.login {
        options.set_credentials(user, password);
    }
    if let Some(TlsAccess { ca, client }) = &access.tls {
        // The process has a single provider; a second call changes nothing.
        let _ = ring::default_provider().install_default();
        options.set_transport(match ca {
            Some(ca) => Transport::tls(ca.clone(), client.clone(), None),
            None => Transport::tls_with_default_config(),
        });
    }
    let (client, mut events) = AsyncClient::new(options, 256);
    let (sender, receiver) = channel(256);
    let (subscriber, of_vehicle) = (client.clone(), vehicle.clone());
    tokio::spawn(async move {
        loop {
            let event = match events.poll().await {
                Ok(Event::Incoming(Packet::ConnAck(_))) => {
                    for topic in subscribed {
                        // The queue is empty after a connection.
                        let _ = subscriber.try_subscribe(of_vehicle.topic(*topic), qos(*topic));
                    }
                    BrokerEvent::Up
                }
                Ok(Event::Incoming(Packet::SubAck(reply))) => {
                    if reply.return_codes.contains(&SubscribeReasonCode::Failure) {
                        warn!(vehicle = %of_vehicle, "the broker refuses a topic of the vehicle to the user");
                    }
                    continue;
                }
                Ok(Event::Incoming(Packet::Publish(message))) => match of_vehicle.topic_of(&message.topic) {
                    Some(topic) => BrokerEvent::Message(topic, message.payload.to_vec()),
                    None => continue,
                },
                Ok(_) => continue,
                Err(problem) => {
                    if sender.send(BrokerEvent::Down(problem.to_string())).await.is_err() {
                        return;
                    }
                    sleep(RECONNECT_AFTER).await;
                    continue;
                }
            };
            if sender.send(event).await.is_err() {
                return;
            }
        }
    });
    (Publisher { client, vehicle: vehicle.clone() }, receiver)
}
