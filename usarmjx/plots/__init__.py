"""Pictures for people: plans and views of arenas, portraits, runs, radio maps and training curves.

`draw_plan` draws an arena from above, `portrait` a robot, `radio_picture` signal strength, `plot_curves`
trainings, `record_episode` and `save_recording` a policy at work, `plot_recording` a recorded mission,
`view_batch` a batch in a notebook.
Private: `render` casts the sensors' rays for a picture. Matplotlib is used through its canvas, never pyplot,
so that nothing global changes. Begin with `draw_plan`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.plots.floor_plan import draw_plan as draw_plan
    from usarmjx.plots.floor_plan import floor_plan_picture as floor_plan_picture
    from usarmjx.plots.gallery import portrait as portrait
    from usarmjx.plots.gallery import portraits as portraits
    from usarmjx.plots.notebook import BatchView as BatchView
    from usarmjx.plots.notebook import view_batch as view_batch
    from usarmjx.plots.play import EpisodeRecording as EpisodeRecording
    from usarmjx.plots.play import record_episode as record_episode
    from usarmjx.plots.play import save_recording as save_recording
    from usarmjx.plots.radio_map import PowerMap as PowerMap
    from usarmjx.plots.radio_map import power_map as power_map
    from usarmjx.plots.radio_map import radio_picture as radio_picture
    from usarmjx.plots.recording import plot_recording as plot_recording
    from usarmjx.plots.recording import read_mission as read_mission
    from usarmjx.plots.training_plots import Curve as Curve
    from usarmjx.plots.training_plots import plot_curves as plot_curves
    from usarmjx.plots.training_plots import read_curves as read_curves
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.plots.floor_plan": ("draw_plan", "floor_plan_picture"),
            "usarmjx.plots.gallery": ("portrait", "portraits"),
            "usarmjx.plots.notebook": ("BatchView", "view_batch"),
            "usarmjx.plots.play": ("EpisodeRecording", "record_episode", "save_recording"),
            "usarmjx.plots.radio_map": ("PowerMap", "power_map", "radio_picture"),
            "usarmjx.plots.recording": ("plot_recording", "read_mission"),
            "usarmjx.plots.training_plots": ("Curve", "plot_curves", "read_curves"),
        },
    )
