//! The specification state of a world: what its judge must remember and no task of the cell can see.

use crate::scenario::{Behaviour, Scenario, Watch};
use crate::state::Violation;
use imrs_protocol::{
    Contents, Event, Frame, MessageId, Observation, Outcome, Overflow, ReplyTo, Round, Seq24, Signal, TaskId,
};

/// The specification state of one task: rounds and counts that the property needs, and attempts or sends left.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct Ghost {
    /// Attempts or sends left; [`Ghost::ENDLESS`] for no limit.
    pub left: u8,
    /// The round that the task waits in.
    pub waits_in: Option<Round>,
    /// Rounds that the task announced, was released from, and left without a release: bit `i` is the base plus `i`.
    pub announced: u32,
    pub released: u32,
    pub gave_up: u32,
    /// Rounds that another member had left when this node restarted: the new incarnation cannot meet it there.
    pub missed: u32,
    /// How often the task reached and was released, and its last round (for pairing).
    pub reached: u8,
    pub releases: u8,
    pub last_released: Option<Round>,
    /// Attempts since the faults ended, up to the first release since then.
    pub since_heal: u8,
    /// Whether the task was released since the faults ended.
    pub met: bool,
    /// The command that the task must answer.
    pub serving: Option<ReplyTo>,
    /// Ticks since its outstanding command was sent, or its wait at the waitfor began.
    pub open: Option<u8>,
    /// Bit `i`: its message `next - 1 - i` was handed over.
    pub executed: u8,
    /// True remaining times of its status messages: `(sequence, ticks)`.
    pub statuses: Vec<(Seq24, u8)>,
}

impl Ghost {
    pub const ENDLESS: u8 = u8::MAX;

    pub fn new(behaviour: Behaviour) -> Self {
        let left = match behaviour {
            Behaviour::Member { attempts, .. } => attempts.unwrap_or(Self::ENDLESS),
            Behaviour::Sender { sends, .. } => sends,
            Behaviour::Receiver => 0,
        };
        Self { left, ..Self::default() }
    }

    pub fn use_one(&mut self) {
        if self.left != Self::ENDLESS {
            self.left = self.left.saturating_sub(1);
        }
    }
}

fn bit(round: Round, base: Round) -> Result<u32, Violation> {
    1_u32.checked_shl(u32::from(round.steps_from(base))).ok_or(Violation::Overflow)
}

/// Judges what one step showed. `base` is the round that bit 0 of the masks stands for.
pub(crate) struct Judge<'a> {
    pub scenario: &'a Scenario,
    pub ghosts: &'a mut [Ghost],
    pub healed: bool,
    pub base: Round,
    /// Set when the property is shown: the state is then final.
    pub done: bool,
}

impl Judge<'_> {
    pub fn observed(&mut self, at: TaskId, seen: &Observation) -> Result<(), Violation> {
        #[expect(clippy::cast_possible_truncation, reason = "a round observed is 16 bits wide")]
        let round = Round(seen.number as u16);
        let ghost = &mut self.ghosts[at.index()];
        match seen.event {
            Event::Reached | Event::Rejoined => {
                if let Some(old) = ghost.waits_in {
                    ghost.gave_up |= bit(old, self.base)?;
                }
                ghost.announced |= bit(round, self.base)?;
                ghost.waits_in = Some(round);
                if seen.event == Event::Reached {
                    ghost.reached = ghost.reached.saturating_add(1);
                    if self.healed && !ghost.met {
                        ghost.since_heal = ghost.since_heal.saturating_add(1);
                    }
                }
            }
            Event::GaveUp => {
                ghost.gave_up |= bit(round, self.base)?;
                ghost.waits_in = None;
                ghost.open = None;
                let all_reached = self.ghosts.iter().all(|g| g.announced != 0);
                if self.scenario.watch == Watch::GaveUpAfterAllArrived && all_reached {
                    return Err(Violation::GaveUpAfterAllArrived);
                }
            }
            _ => {}
        }
        if let Watch::MeetAgain { attempts } = self.scenario.watch
            && self.ghosts[at.index()].since_heal > attempts
        {
            return Err(Violation::NotMet);
        }
        Ok(())
    }

    pub fn signalled(
        &mut self,
        at: TaskId,
        signal: &Signal,
        awaits: impl Fn(TaskId) -> Option<(TaskId, MessageId)>,
    ) -> Result<(), Violation> {
        match signal {
            Signal::Released { round, .. } => self.released(at, *round),
            Signal::Message(delivery) => {
                let source = delivery.from.source;
                let command = delivery.class == imrs_protocol::Class::Command;
                if command {
                    self.ghosts[at.index()].serving = Some(delivery.from);
                    // The contents identify the command, even where sequence numbers wrap.
                    let left = delivery.contents.as_bytes().first().copied().unwrap_or(0);
                    let back = left.saturating_sub(self.ghosts[source.index()].left).saturating_add(1);
                    self.executed(source, back)?;
                }
                if self.scenario.watch == Watch::Stale {
                    let alive = if command {
                        awaits(source) == Some((at, delivery.from.id))
                    } else {
                        let statuses = &self.ghosts[source.index()].statuses;
                        statuses.iter().any(|&(sequence, _)| sequence == delivery.from.id.sequence)
                    };
                    if !alive {
                        return Err(Violation::Stale);
                    }
                }
                Ok(())
            }
            Signal::Outcome(outcome) => self.ended(at, outcome),
            _ => Ok(()),
        }
    }

    fn released(&mut self, at: TaskId, round: Round) -> Result<(), Violation> {
        let bit = bit(round, self.base)?;
        let ghost = &mut self.ghosts[at.index()];
        ghost.released |= bit;
        ghost.waits_in = None;
        ghost.open = None;
        ghost.releases = ghost.releases.saturating_add(1);
        ghost.last_released = Some(round);
        let releases = ghost.releases;
        match self.scenario.watch {
            Watch::FalseRelease
                if self.ghosts.iter().any(|g| g.announced & bit == 0)
                    || self.ghosts[at.index()].missed & bit != 0 =>
            {
                Err(Violation::FalseRelease)
            }
            Watch::Pairing if self.ghosts.iter().any(|g| g.reached < releases) => {
                Err(Violation::FalseRelease)
            }
            Watch::Pairing => {
                let same = |g: &Ghost| g.releases != releases || g.last_released == Some(round);
                let ahead = |g: &Ghost| g.releases > releases;
                if self.ghosts.iter().all(|g| same(g) && !ahead(g)) {
                    Ok(())
                } else {
                    Err(Violation::Unpaired)
                }
            }
            Watch::Reachable => Err(Violation::Released),
            Watch::MeetAgain { .. } => {
                self.ghosts[at.index()].met = self.healed;
                self.done = self.ghosts.iter().all(|ghost| ghost.met);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Records a delivery: of the command that `source` sent `back - 1` commands before its last one.
    fn executed(&mut self, source: TaskId, back: u8) -> Result<(), Violation> {
        let bit = 1_u8.checked_shl(u32::from(back.saturating_sub(1))).ok_or(Violation::Overflow)?;
        let ghost = &mut self.ghosts[source.index()];
        let again = ghost.executed & bit != 0;
        ghost.executed |= bit;
        if again && self.scenario.watch == Watch::AtMostOnce { Err(Violation::ExecutedTwice) } else { Ok(()) }
    }

    fn ended(&mut self, at: TaskId, outcome: &Outcome) -> Result<(), Violation> {
        let ghost = &mut self.ghosts[at.index()];
        let open = ghost.open.take();
        if self.scenario.watch == Watch::Answered && !matches!(outcome, Outcome::Reply(_)) {
            return Err(Violation::Unanswered);
        }
        if !matches!(self.scenario.watch, Watch::Resolves | Watch::ResolvesOnce) {
            return Ok(());
        }
        if open.is_none() {
            return Err(Violation::SecondOutcome);
        }
        match outcome {
            Outcome::Reply(contents) if *contents != question(ghost.left) => Err(Violation::WrongAnswer),
            _ => Ok(()),
        }
    }

    /// Judges all rounds after a step: no round may be released at one member and left without a release by another.
    pub fn judge_round(&self) -> Result<(), Violation> {
        if self.scenario.watch != Watch::AllOrNone {
            return Ok(());
        }
        let released = self.ghosts.iter().fold(0, |mask, g| mask | g.released);
        let left = self.ghosts.iter().fold(0, |mask, g| mask | g.gave_up);
        if released & left == 0 { Ok(()) } else { Err(Violation::Divergent) }
    }
}

/// The contents of the command after which `left` sends remain. Its answer must repeat them.
pub(crate) fn question(left: u8) -> Contents {
    Contents::new(&[left]).unwrap_or_default()
}

/// Packs what the property needs of the specification state of one task. `shift` is how far the base has moved.
pub(crate) fn store(
    ghost: &Ghost,
    watch: Watch,
    frame: &Frame<'_>,
    shift: u32,
    task: TaskId,
    least: u8,
    out: &mut Vec<u8>,
) -> Result<(), Overflow> {
    let mask = |mask: u32| u8::try_from(mask.checked_shr(shift).unwrap_or(0)).map_err(|_| Overflow);
    out.push(ghost.left);
    match watch {
        Watch::FalseRelease => {
            out.push(mask(ghost.announced)?);
            if frame.lives {
                out.push(mask(ghost.missed)?);
            }
        }
        Watch::AllOrNone => out.extend([mask(ghost.released)?, mask(ghost.gave_up)?]),
        Watch::Pairing => {
            let round = match ghost.last_released {
                Some(round) => u8::try_from(round.steps_from(frame.rounds[0]) + 1).map_err(|_| Overflow)?,
                None => 0,
            };
            out.extend([ghost.reached - least, ghost.releases - least, round]);
        }
        Watch::MeetAgain { .. } => out.extend([ghost.since_heal, u8::from(ghost.met)]),
        Watch::GaveUpAfterAllArrived | Watch::Stranded => out.push(u8::from(ghost.announced != 0)),
        Watch::Reachable => {}
        Watch::Stale
        | Watch::Resolves
        | Watch::ResolvesOnce
        | Watch::Answered
        | Watch::AtMostOnce
        | Watch::Waits => {
            let next = |task: TaskId| frame.sequences.get(task.index()).copied().unwrap_or_default();
            match ghost.serving {
                None => out.push(0),
                Some(to) => {
                    let back = next(to.source).steps_from(to.id.sequence);
                    out.push(u8::try_from(to.source.index() + 1).map_err(|_| Overflow)?);
                    out.extend([u8::try_from(to.port.index()).map_err(|_| Overflow)?, to.id.incarnation.0]);
                    out.push(u8::try_from(back).map_err(|_| Overflow)?);
                }
            }
            match watch {
                Watch::Resolves | Watch::ResolvesOnce | Watch::Waits => {
                    out.push(ghost.open.map_or(0, |ticks| ticks.saturating_add(1)));
                }
                Watch::AtMostOnce => out.push(ghost.executed),
                _ => {
                    out.push(u8::try_from(ghost.statuses.len()).map_err(|_| Overflow)?);
                    for &(sequence, left) in &ghost.statuses {
                        let back = next(task).steps_from(sequence);
                        out.extend([u8::try_from(back).map_err(|_| Overflow)?, left]);
                    }
                }
            }
        }
    }
    Ok(())
}

/// Unpacks the specification state of one task. Returns the number of bytes read.
pub(crate) fn load(ghost: &mut Ghost, watch: Watch, lives: bool, bytes: &[u8]) -> usize {
    let mut at = 0;
    let mut byte = || {
        let byte = bytes.get(at).copied().unwrap_or(0);
        at += 1;
        byte
    };
    let statuses = std::mem::take(&mut ghost.statuses);
    *ghost = Ghost { left: byte(), statuses, ..Ghost::default() };
    ghost.statuses.clear();
    let sequence = |back: u8| Frame::SEQUENCE.plus(Seq24::MODULUS - u32::from(back));
    match watch {
        Watch::FalseRelease => {
            ghost.announced = u32::from(byte());
            if lives {
                ghost.missed = u32::from(byte());
            }
        }
        Watch::AllOrNone => (ghost.released, ghost.gave_up) = (u32::from(byte()), u32::from(byte())),
        Watch::Pairing => {
            (ghost.reached, ghost.releases) = (byte(), byte());
            ghost.last_released = byte().checked_sub(1).map(|round| Frame::ROUND.plus(u16::from(round)));
        }
        Watch::MeetAgain { .. } => (ghost.since_heal, ghost.met) = (byte(), byte() == 1),
        Watch::GaveUpAfterAllArrived | Watch::Stranded => ghost.announced = u32::from(byte()),
        Watch::Reachable => {}
        Watch::Stale
        | Watch::Resolves
        | Watch::ResolvesOnce
        | Watch::Answered
        | Watch::AtMostOnce
        | Watch::Waits => {
            if let Some(source) = byte().checked_sub(1) {
                let (port, life, back) = (byte(), byte(), byte());
                let id =
                    MessageId { incarnation: imrs_protocol::Incarnation(life), sequence: sequence(back) };
                let (source, port) = (TaskId(u16::from(source)), imrs_protocol::PortId(u16::from(port)));
                ghost.serving = Some(ReplyTo { port, source, id });
            }
            match watch {
                Watch::Resolves | Watch::ResolvesOnce | Watch::Waits => ghost.open = byte().checked_sub(1),
                Watch::AtMostOnce => ghost.executed = byte(),
                _ => {
                    for _ in 0..byte() {
                        let (back, left) = (byte(), byte());
                        ghost.statuses.push((sequence(back), left));
                    }
                }
            }
        }
    }
    at
}
