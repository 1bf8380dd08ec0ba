//! The screens of the monitor.

/// A screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Screen {
    /// Nodes, tasks and ports.
    #[default]
    Overview,
    /// One port's queue.
    Port,
    /// The history of one message, from sending to its end.
    Message,
    /// Who waits for whom.
    Rendezvous,
    /// The events of each task, side by side.
    Timeline,
    /// Timers and deadlines.
    Timers,
    /// The event log.
    Events,
    /// Whether the nodes conform to the model.
    Model,
    /// Findings and the nearest deadlines, over all nodes.
    Problems,
    /// The page about the code of a finding.
    Explain,
    /// The settings of the running monitor, over another screen.
    Settings,
    /// The keys and signs.
    Help,
}

impl Screen {
    /// All of them.
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
