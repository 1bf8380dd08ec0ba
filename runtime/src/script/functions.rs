//! Actions that are functions of the program that runs the node.

use super::actions::{Act, Actions, Ending, Stop};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// A function that carries out an action. It returns the action's result, or why the action failed.
type Function = Arc<dyn Fn(&Call) -> Result<i32, String> + Send + Sync>;

/// The argument of a function that carries out an action.
#[derive(Clone, Debug)]
pub struct Call {
    /// The name of the task.
    pub task: String,
    /// The action's arguments; a `real` is given by its bits.
    pub arguments: Vec<i64>,
    /// The least time that the action takes.
    pub least: Duration,
    /// The longest time that the action takes.
    pub most: Duration,
    cut_short: Arc<AtomicBool>,
}

impl Call {
    /// Whether the action was cut short: then the robot must not act any more, and the result is ignored.
    #[must_use]
    pub fn is_cut_short(&self) -> bool {
        self.cut_short.load(Ordering::Acquire)
    }
}

/// Calls a function for each action that has one, each call on a thread of its own. Another [`Actions`] carries out the
/// other actions.
pub struct Functions {
    functions: BTreeMap<String, Function>,
    others: Arc<dyn Actions>,
}

impl Functions {
    /// Makes a value without functions: `others` carries out every action.
    #[must_use]
    pub fn new(others: Arc<dyn Actions>) -> Self {
        Self { functions: BTreeMap::new(), others }
    }

    /// Sets the function for actions of this name. If the function panics, the action has failed.
    #[must_use]
    pub fn action(
        mut self,
        name: &str,
        function: impl Fn(&Call) -> Result<i32, String> + Send + Sync + 'static,
    ) -> Self {
        self.functions.insert(name.into(), Arc::new(function));
        self
    }
}

impl Actions for Functions {
    fn begin(&self, act: &Act<'_>, ending: Ending) -> Option<Stop> {
        let Some(function) = self.functions.get(act.name).cloned() else {
            return self.others.begin(act, ending);
        };
        let cut_short = Arc::new(AtomicBool::new(false));
        let call = Call {
            task: act.task.into(),
            arguments: act.arguments.to_vec(),
            least: act.least,
            most: act.most,
            cut_short: Arc::clone(&cut_short),
        };
        // A panic, or a failed spawn, drops the ending, which then says that the action failed.
        let _ = thread::Builder::new().name(format!("action {}", act.name)).spawn(move || {
            match function(&call) {
                Ok(value) => ending.done(value),
                Err(_) => ending.failed(),
            }
        });
        Some(Box::new(move || cut_short.store(true, Ordering::Release)))
    }
}
