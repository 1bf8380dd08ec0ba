//! Which screens there are.

/// The screens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Screen {
    /// Nodes, tasks and ports.
    #[default]
    Overview,
    /// One port's queue.
    Port,
    /// One message, from its birth to its end.
    Message,
    /// Who waits for whom.
    Rendezvous,
    /// What happened in each task, side by side.
    Timeline,
    /// What runs out when.
    Timers,
    /// What happened.
    Events,
    /// Whether the nodes do what the model does.
    Model,
    /// The keys and signs.
    Help,
}

impl Screen {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Overview,
        Self::Port,
        Self::Message,
        Self::Rendezvous,
        Self::Timeline,
        Self::Timers,
        Self::Events,
        Self::Model,
        Self::Help,
    ];
}
