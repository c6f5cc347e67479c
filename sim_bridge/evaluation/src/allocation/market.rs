//! The way to the robots.

use super::bidder::{Order, Prices};
use std::future::Future;

/// Asks robots. The robots of an instance have the numbers from 0 on.
pub trait Market {
    /// Sends an order to each of these robots, and returns their prices in the same order.
    fn ask(&mut self, orders: Vec<(usize, Order)>) -> impl Future<Output = Vec<Prices>>;
}
