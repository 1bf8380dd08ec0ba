//! What the tasks of the beam lift do. The robots are simulated; their communication is not.

use crate::cells::beam_lift::{ARM_L, ARM_R, BEAT, HALT, HOIST, LIFT};
use crate::launch::clock::now_us;
use crate::launch::probe::Probe;
use fastrand::Rng;
use imrs_protocol::{Delivery, Fault, PortId, Ranked, Round};
use imrs_runtime::{Context, Rendezvous, RequestFault, TaskError};
use std::ops::Range;
use std::time::Duration;

/// The program of a task: runs until the node stops.
pub type Program = Box<dyn FnOnce(&mut Context) -> Result<(), TaskError> + Send>;

/// How many heart-beats one lift takes.
const STEPS: u8 = 4;
/// The time between two heart-beats.
const PERIOD: Duration = Duration::from_millis(3);
/// How long the right arm moves without hearing of the left one.
const SILENCE: Duration = Duration::from_millis(40);
/// How long the hoist winds without hearing that it should stop.
const WINDING: Duration = Duration::from_millis(50);

/// The program of the task of this name.
pub fn program(task: &str, probe: Probe, seed: u64) -> Option<Program> {
    // Seeded by name, so that no two tasks work in step.
    let salt = task.bytes().fold(0_u64, |hash, byte| hash.wrapping_mul(31).wrapping_add(u64::from(byte)));
    let robot = Robot { probe, rng: Rng::with_seed(seed ^ salt) };
    match task {
        ARM_L => Some(Box::new(|ctx| robot.left_arm(ctx))),
        ARM_R => Some(Box::new(|ctx| robot.right_arm(ctx))),
        HOIST => Some(Box::new(|ctx| robot.hoist(ctx))),
        _ => None,
    }
}

/// What every message of the cell says: when it was sent, in which lift, and one more thing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Message {
    sent_us: u64,
    round: Round,
    detail: u8,
}

impl Message {
    fn now(round: Round, detail: u8) -> Self {
        Self { sent_us: now_us(), round, detail }
    }

    fn to_bytes(self) -> [u8; 11] {
        let mut bytes = [0; 11];
        bytes[..8].copy_from_slice(&self.sent_us.to_le_bytes());
        bytes[8..10].copy_from_slice(&self.round.0.to_le_bytes());
        bytes[10] = self.detail;
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (sent_us, rest) = bytes.split_first_chunk()?;
        let (round, rest) = rest.split_first_chunk()?;
        let sent_us = u64::from_le_bytes(*sent_us);
        Some(Self { sent_us, round: Round(u16::from_le_bytes(*round)), detail: *rest.first()? })
    }
}

struct Robot {
    probe: Probe,
    rng: Rng,
}

impl Robot {
    /// Leads: beats while it moves, and says when to stop.
    fn left_arm(mut self, ctx: &mut Context) -> Result<(), TaskError> {
        let (lift, beat, halt) = (ctx.port(LIFT)?, ctx.port(BEAT)?, ctx.port(HALT)?);
        self.probe.wait_for_start();
        loop {
            self.work(ctx, 2_000..4_000)?;
            let Some(round) = self.meet(ctx, lift)? else { continue };
            self.work(ctx, 1_000..2_000)?;
            let mut height = 0;
            while height < STEPS {
                let sent = ctx.send(beat, &Message::now(round, height).to_bytes())?;
                self.probe.sent(sent);
                let partner_moves = sent.reply().is_some_and(|answer| answer.as_bytes() == [1]);
                if !partner_moves {
                    break;
                }
                height += 1;
                ctx.delay(PERIOD)?;
            }
            // Class 1: it is not waited for, and never holds up the own stop.
            self.probe.sent(ctx.send(halt, &Message::now(round, u8::from(height < STEPS)).to_bytes())?);
            self.work(ctx, 1_000..2_000)?;
        }
    }

    /// Answers heart-beats while it moves; stops when told to, or when it hears nothing.
    fn right_arm(mut self, ctx: &mut Context) -> Result<(), TaskError> {
        let (lift, beat, halt) = (ctx.port(LIFT)?, ctx.port(BEAT)?, ctx.port(HALT)?);
        ctx.order(&[Ranked::Port(halt), Ranked::Port(beat)])?;
        self.probe.wait_for_start();
        loop {
            self.work(ctx, 2_000..4_000)?;
            let Some(round) = self.meet(ctx, lift)? else { continue };
            self.work(ctx, 1_000..2_000)?;
            while let Some(delivery) = ctx.receive(None, Some(SILENCE))? {
                let message = Message::from_bytes(delivery.contents.as_bytes());
                let ours = message.is_some_and(|m| m.round == round);
                if delivery.from.port == beat {
                    self.answer(ctx, &delivery, message, ours)?;
                } else if ours {
                    break;
                }
            }
            self.work(ctx, 1_000..2_000)?;
        }
    }

    /// Winds while the arms lift; looks between two steps whether it should stop.
    fn hoist(mut self, ctx: &mut Context) -> Result<(), TaskError> {
        let (lift, halt) = (ctx.port(LIFT)?, ctx.port(HALT)?);
        ctx.order(&[Ranked::Port(halt)])?;
        self.probe.wait_for_start();
        loop {
            self.work(ctx, 0..6_000)?;
            let Some(round) = self.meet(ctx, lift)? else { continue };
            let end = now_us() + u64::try_from(WINDING.as_micros()).unwrap_or(u64::MAX);
            while now_us() < end && !halted(ctx, halt, round)? {
                self.work(ctx, 1_000..2_000)?;
            }
        }
    }

    /// Meets the others. `None` says that they did not all come; then nobody starts.
    fn meet(&mut self, ctx: &mut Context, lift: PortId) -> Result<Option<Round>, TaskError> {
        let asked = now_us();
        match ctx.waitfor(lift)? {
            Rendezvous::Released { round, .. } => {
                self.probe.released(ctx.id(), lift, round);
                Ok(Some(round))
            }
            Rendezvous::GaveUp { round, missing } => {
                self.probe.gave_up(ctx.id(), lift, round, asked, missing);
                Ok(None)
            }
        }
    }

    /// Carries out a heart-beat, if its sender still waits: the answer is the proof that it was in time.
    fn answer(
        &mut self,
        ctx: &mut Context,
        delivery: &Delivery,
        message: Option<Message>,
        moving: bool,
    ) -> Result<(), TaskError> {
        let taken_up = now_us();
        match ctx.reply(&delivery.from, &[u8::from(moving)]) {
            Ok(()) => {
                let age = message.map_or(0, |m| taken_up.saturating_sub(m.sent_us));
                self.probe.executed(delivery.from.port, age);
                Ok(())
            }
            Err(TaskError::Fault(RequestFault(Fault::Late))) => {
                self.probe.turned_away();
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    /// The robot does something for some microseconds.
    fn work(&mut self, ctx: &mut Context, us: Range<u64>) -> Result<(), TaskError> {
        ctx.delay(Duration::from_micros(self.rng.u64(us)))
    }
}

/// Whether the order to stop this lift has come. One of an earlier lift is no order for this one.
fn halted(ctx: &mut Context, halt: PortId, round: Round) -> Result<bool, TaskError> {
    while let Some(delivery) = ctx.poll(Some(halt))? {
        if Message::from_bytes(delivery.contents.as_bytes()).is_some_and(|m| m.round == round) {
            return Ok(true);
        }
    }
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::beam_lift;
    use imrs_protocol::CONTENTS_BYTES;

    #[test]
    fn messages_fit_a_packet_and_come_out_as_they_went_in() {
        let message = Message { sent_us: u64::MAX - 7, round: Round(0xbeef), detail: 3 };
        let bytes = message.to_bytes();
        assert!(bytes.len() <= CONTENTS_BYTES);
        assert_eq!(Message::from_bytes(&bytes), Some(message));
        assert_eq!(Message::from_bytes(&bytes[..10]), None);
    }

    #[test]
    fn every_task_of_the_cell_has_a_program() {
        for task in beam_lift::cell().tasks {
            assert!(program(&task.name, Probe::detached(), 1).is_some(), "{}", task.name);
        }
        assert!(program("other", Probe::detached(), 1).is_none());
    }
}
