//! Tests a node with more futures than one word of marks has bits (D178).

use crate::common::{finish, one_node, table};
use crate::futures::Told;
use imrs_protocol::{Cell, Ticks};
use std::sync::{Arc, Mutex};

/// The marks of seventy futures take two words. Each future except the last is woken by the next one.
#[test]
fn each_of_seventy_futures_is_polled_when_it_is_told() {
    const COUNT: usize = 70;
    let mut cell = Cell::new("test", Ticks(1_000));
    let node = cell.node("n0");
    for task in 0..COUNT {
        cell.task(&format!("t{task}"), node);
    }
    let told: Arc<[Told]> = (0..=COUNT).map(|_| Told::default()).collect();
    let order = Arc::new(Mutex::new(Vec::new()));
    let mut node = one_node(&table(cell));
    for task in 0..COUNT {
        let (told, order) = (Arc::clone(&told), Arc::clone(&order));
        node = node.async_task(&format!("t{task}"), move |_ctx| async move {
            told[task + 1].hear().await;
            order.lock().unwrap().push(task);
            told[task].tell();
            Ok(())
        });
    }
    let node = node.start().unwrap();
    told[COUNT].tell();
    finish(node);
    assert_eq!(*order.lock().unwrap(), (0..COUNT).rev().collect::<Vec<_>>());
}
