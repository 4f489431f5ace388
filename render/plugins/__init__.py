"""A scene in Mitsuba's terms: camera and projector plugins, surfaces, the variant in use."""
