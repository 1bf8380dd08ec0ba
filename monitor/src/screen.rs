//! The screens of the monitor.

/// A screen of the monitor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Screen {
    /// The nodes, tasks and ports.
    #[default]
    Overview,
    /// The queue of one port.
    Port,
    /// The history of one message, from sending to its end.
    Message,
    /// Which task waits for which.
    Rendezvous,
    /// The events of each task, side by side.
    Timeline,
    /// The timers and deadlines.
    Timers,
    /// The event log.
    Events,
    /// Whether the nodes conform to the verified state machine.
    Model,
    /// The findings and the nearest deadlines of all nodes.
    Problems,
    /// The page about the code of a finding.
    Explain,
    /// The settings of the running monitor, drawn over another screen.
    Settings,
    /// The keys and the signs of the screens.
    Help,
}

impl Screen {
    /// All screens.
    pub const ALL: [Self; 12] = [
        Self::Overview,
        Self::Port,
        Self::Message,
        Self::Rendezvous,
        Self::Timeline,
        Self::Timers,
        Self::Events,
        Self::Model,
        Self::Problems,
        Self::Explain,
        Self::Settings,
        Self::Help,
    ];
}
