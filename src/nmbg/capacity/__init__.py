"""No more model than a scene needs: each part is sized by left-out training views, never by test views."""
