"""What a training leaves behind while it goes: logged figures, scores of held-out views, checkpoints, its pace."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsjax import runs
from gsjax.metrics.photos import score_images
from gsjax.planning.effects import ChosenEffects
from gsjax.planning.pace import Pace, duration_text, seconds_left
from gsjax.runs.journal import Journal
from gsjax.runs.photo_effects import with_moved_cameras
from gsjax.scene import Scene
from gsjax.training.densification import gradient_driven
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.loop import Progress
from gsjax.training.plan import Plan
from gsjax.training.state import TrainState, count_alive


class TrainingJournal(Journal):
    """Logs, scores and saves as the plan says."""

    def __init__(
        self,
        run: Path,
        planned: Plan,
        scene: Scene,
        step: int,
        seconds: float,
        effects: ChosenEffects,
        whole: Callable[[TrainState], TrainState] = lambda state: state,
    ):
        """Begin at `step`; `whole` gathers a state on one device."""
        super().__init__(run, "train", planned.steps, step, seconds)
        self.plan, self.scene, self.chosen = planned, scene, effects
        self._pace, self.whole, self._held = Pace(), whole, False
        self._ends = {phase.end for phase in planned.phases}
        self.evaluate_every = planned.logging.evaluate_every if scene.held_out_frames else 0

    def note(self, progress: Progress) -> None:
        """Log, score and save after a step."""
        self.bar.set_description(progress.phase.name, refresh=False)
        self.bar.update()
        self._tell_pace(progress)
        scored, logged, saved = self._due(progress.step)
        if logged:
            count = int(count_alive(progress.state.gaussians))
            more: dict[str, Any] = {"phase": progress.phase.name, "gaussians": count}
            if scored:
                more |= self._held_out(self.whole(progress.state))
            self.log(progress.step, progress.metrics, f", {count:,} Gaussians", **more)
            self._tell_held(progress, count)
        if saved:
            # The last step of a phase leaves the buffer's capacity to the next phase.
            self.save(progress.step, self.whole(progress.state), 0 if progress.phase_done else progress.capacity)

    def looks(self, step: int) -> bool:
        """Whether the state after so many steps is logged, scored or saved."""
        return any(self._due(step))

    def _due(self, step: int) -> tuple[bool, bool, bool]:
        """Whether held-out views are scored after so many steps, figures logged, and a checkpoint saved."""
        every, last = self.plan.logging, step == self.steps
        grows = any(phase.rule and phase.begin < step <= phase.end for phase in self.plan.phases)
        # Pictures of opacities that have just been reset have no meaning.
        is_reset = grows and gradient_driven.resets_opacities(self.plan.density, step, self.plan.background)
        scored = self.evaluate_every > 0 and step % self.evaluate_every == 0 and not (last or is_reset)
        logged = scored or last or step % every.metrics_every == 0
        # Where a phase ends another run may begin (`train`, `warm_start`).
        return scored, logged, step in self._ends or step % every.checkpoint_every == 0

    def _held_out(self, state: TrainState) -> dict[str, float]:
        """PSNR of the views that are held out, of the render as it is and, with effects on light, as photos near it."""
        planned, photo_effects = self.plan, self.chosen.photo_effects(state.effects)
        frames = with_moved_cameras(self.scene.held_out_frames, photo_effects.moves)
        # The other scores come at the end.
        photo_effects = photo_effects.with_near_appearances(self.scene.frames)._replace(appearances={})
        scores = score_images(
            state.gaussians, frames, planned.background, photo_effects=photo_effects, depth_mode=planned.depth_mode
        )
        return {f"held_out_{name}": score for name, score in scores.items() if name.startswith("psnr")}

    def _tell_held(self, progress: Progress, count: int) -> None:
        """Once, that no more Gaussians may grow, where a rule grows them without a budget in mind (3DGS)."""
        if self._held or progress.phase.rule is not DENSIFICATION_RULES["adc"] or count < self.plan.max_gaussians:
            return
        self._held = True
        line = f"densification is limited to max_gaussians={self.plan.max_gaussians:,} from step {progress.step:,} on"
        self.bar.write(f"train: {line}", sys.stderr)
        runs.update_manifest(self.run, growth=line)

    def _tell_pace(self, progress: Progress) -> None:
        """How long the rest will take, once a phase."""
        pace = self._pace.seconds_per_step(progress.phase)
        if pace is not None:
            left = seconds_left(self.plan, progress.step, progress.phase, pace)
            self.bar.write(
                f"{progress.phase.name}: {1e3 * pace:.0f} ms a step, about {duration_text(left)} to go", sys.stderr
            )
